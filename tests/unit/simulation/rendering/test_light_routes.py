"""Ways of light: to particles through walls, and the routes that carry it."""

import math
import tomllib
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering import particle_images
from sabench.simulation.rendering.particle_images import (
    SMOOTH,
    Box,
    Route,
    find_paths,
    image_particles,
    reflections,
)
from sabench.utils.arrays import F64, triple
from tests.helpers.particle_scenes import cloud, make_scene

REAR = (Layer("glass", 1.52, 4.0), Layer("acrylic", 1.49, 6.0))
FRONT = [
    {"name": "glass", "index": 1.52, "thickness_mm": 5.0},
    {"name": "gel", "index": 1.4, "thickness_mm": 3.0},
]
WALL: dict[str, Any] = {"layers": FRONT, "normal": [0.1, -0.05, 1.0], "depth_mm": 60.0}


def scene_of(**wall: Any) -> Scene:
    rear = [asdict(one) for one in REAR]
    return make_scene(wall=WALL | {"rear": rear} | wall, illumination={"thickness_mm": 1e3})


def routes_of(camera: Camera) -> list[Route]:
    assert isinstance(camera.wall, Wall)
    return reflections(camera.wall, REAR)


def turn(direction: F64, normal: F64, before: float, after: float) -> F64:
    """Refract a direction by Snell's law with vectors."""
    cosine, ratio = direction @ normal, before / after
    bend = math.copysign(math.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)), cosine)
    return np.asarray(ratio * direction + (bend - ratio * cosine) * normal)


def follow(camera: Camera, pixel: F64, moves: list[tuple[float, float, float]]) -> list[F64]:
    """Follow a ray by moves (depth of the next face, indices before and after); 0: it reflects."""
    wall = camera.wall
    assert isinstance(wall, Wall)
    normal, place = np.asarray(wall.normal), np.asarray(camera.center_mm)
    direction = camera.directions(pixel[None])[0][0]
    for depth, before, after in moves:
        place = place + (depth - wall.depth_of(place)) / (direction @ normal) * direction
        if after:
            direction = turn(direction, normal, before, after)
        else:
            direction = direction - 2.0 * (direction @ normal) * normal
    return [place, direction]


def moves_of(kind: str) -> list[tuple[float, float, float]]:
    """Moves through the faces of the walls, whose depths are 0, 5, 8; 68, 72, 78 mm."""
    into = [(0.0, 1.0, 1.52), (5.0, 1.52, 1.4), (8.0, 1.4, 1.333)]
    rear, back = [(68.0, 1.333, 1.52), (72.0, 1.52, 1.49)], [(68.0, 1.52, 1.333)]
    acrylic = [*rear, (78.0, 1.49, 0.0), (72.0, 1.49, 1.52)]
    front = [(8.0, 1.4, 0.0), (5.0, 1.4, 1.52), (0.0, 1.52, 0.0)]
    return {
        "water": [*into, (68.0, 1.333, 0.0)],
        "glass": [*into, rear[0], (72.0, 1.52, 0.0), *back],
        "acrylic": [*into, *acrylic, *back],
        "front glass": [into[0], (5.0, 1.52, 0.0), (0.0, 1.52, 0.0), *into[1:]],
        "front both": [*into[:2], *front, *into[1:]],
        "front gel": [*into[:2], (8.0, 1.4, 0.0), (5.0, 1.4, 0.0), into[2]],
    }[kind]


KINDS = ("front glass", "front both", "front gel", "water", "glass", "acrylic")  # as listed


@pytest.mark.slow_but_first
@pytest.mark.parametrize("kind", KINDS)
def test_a_ray_from_the_reflected_image_meets_the_particle(kind: str) -> None:
    scene = scene_of()
    points = np.random.default_rng(1).uniform([-4.0, -3.0, 20.0], [4.0, 3.0, 50.0], (4, 3))
    for camera in build_rig(scene).cameras[::3]:
        route = routes_of(camera)[KINDS.index(kind)]
        images = image_particles(scene, camera, cloud(points), None, (), route)
        for point, pixel, seen in zip(points, images.pixel, images.direction, strict=True):
            place, direction = follow(camera, pixel, moves_of(kind))
            assert np.linalg.norm(np.cross(point - place, direction)) < 1e-6
            np.testing.assert_allclose(route.at_particle(seen[None])[0], direction, atol=1e-9)


def test_reflected_shares_are_fresnel_s() -> None:
    camera = build_rig(scene_of()).cameras[0]
    assert isinstance(camera.wall, Wall)
    normal = np.asarray(camera.wall.normal)
    found = [float(route.reflected(normal[None])[0]) for route in routes_of(camera)]

    def share(before: float, after: float) -> float:
        return ((before - after) / (before + after)) ** 2

    outer, middle, inner = share(1.0, 1.52), share(1.52, 1.4), share(1.4, 1.333)
    expected = [outer * middle, outer * inner, middle * inner]
    expected += [share(1.333, 1.52), share(1.52, 1.49), share(1.49, 1.0)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    across = np.cross(normal, [0.0, 1.0, 0.0])
    slanted = np.cos(1.2) * normal + np.sin(1.2) * across / np.linalg.norm(across)
    inside = math.asin(math.sin(1.2) / 1.333), math.asin(math.sin(1.2) / 1.52)
    s = (math.sin(inside[0] - inside[1]) / math.sin(inside[0] + inside[1])) ** 2
    p = (math.tan(inside[0] - inside[1]) / math.tan(inside[0] + inside[1])) ** 2
    found_slanted = routes_of(camera)[3].reflected(slanted[None])[0]
    assert found_slanted == pytest.approx((s + p) / 2.0, rel=1e-9)


def test_a_bare_glass_wall_mirrors_some_five_hundredths_of_the_light() -> None:
    rear = [{"name": "glass", "index": 1.52, "thickness_mm": 0.001}]
    scene = make_scene(wall={"depth_mm": 30.0, "rear": rear}, illumination={"thickness_mm": 1e3})
    camera, light = build_rig(scene).cameras[0], cloud(np.array([[0.0, 0.0, 34.9]]))
    assert isinstance(camera.wall, Wall)
    straight = image_particles(scene, camera, light, None).photons[0]
    routes = reflections(camera.wall, (Layer("glass", 1.52, 0.001),))[-2:]
    mirrored = sum(image_particles(scene, camera, light, None, (), r).photons[0] for r in routes)
    assert mirrored / straight == pytest.approx(0.047, abs=0.001)


def test_both_renderers_mirror_alike_and_without_the_key_nothing_is_mirrored() -> None:
    wall = {"depth_mm": 29.0, "rear": [{"name": "glass", "index": 1.52, "thickness_mm": 4.0}]}
    views = []
    for mirrors, renderer in ((True, "mitsuba"), (True, "splat"), (None, "splat")):
        changes = wall if mirrors is None else wall | {"mirrors": mirrors}
        scene = make_scene(wall=changes, particles={"count": 12, "diameter_spread": 0.0})
        frame = Frames(scene, build_rig(scene), 3, renderer).at(0)
        views.append(camera_view.render_camera_view(frame, 1).photons)
    traced, splatted, plain = views
    extra = splatted - plain
    assert extra.min() > -1e-9
    assert 0.02 < extra.sum() / plain.sum() < 0.06
    assert traced.sum() == pytest.approx(splatted.sum(), rel=5e-3)
    faint = extra > 0.2 * extra.max()
    assert np.abs(traced - splatted)[faint].max() < 0.1 * extra.max()


def bundled(name: str) -> Scene:
    return parse_scene(tomllib.loads(find(name, "scenes").read_text(encoding="utf-8")), name)


def volume_of(scene: Scene) -> Box:
    center, half = np.asarray(scene.volume.center_mm), np.asarray(scene.volume.size_mm) / 2.0
    return triple(center - half), triple(center + half)


def points_in(box: Box, count: int) -> F64:
    low, high = np.asarray(box)
    return np.asarray(low + (high - low) * np.random.default_rng(5).random((count, 3)))


@pytest.mark.parametrize(
    "name", ["quick", "standard-particles", "scheimpflug", "two-faces", "cylinder-tank"]
)
def test_polynomials_are_as_good_as_exact_paths(name: str) -> None:
    scene = bundled(name)
    box = volume_of(scene)
    points = points_in(box, 3000)
    for camera in build_rig(scene, name).cameras[:3]:
        assert particle_images._interpolate(camera, box) is not None
        found, exact = find_paths(camera, points, box), find_paths(camera, points)
        np.testing.assert_allclose(found.pixel, exact.pixel, rtol=0, atol=1e-9)
        assert found.valid.all()
        assert exact.valid.all()
        for one in SMOOTH:
            truth = getattr(exact, one)
            error = np.abs(getattr(found, one) - truth).max()
            assert error <= 2e-7 * max(np.abs(truth).max(), 0.01), one


def camera_of(name: str) -> tuple[Camera, Box]:
    scene = bundled(name)
    return build_rig(scene, name).cameras[0], volume_of(scene)


def test_a_thin_volume_needs_fewer_terms_and_a_tiny_one_one() -> None:
    """Terms of high powers of its depth go; the value in the middle is left."""
    camera, (low, high) = camera_of("quick")
    middle = (np.asarray(low) + np.asarray(high)) / 2.0
    thin = (*low[:2], middle[2] - 0.1), (*high[:2], middle[2] + 0.1)
    tiny = triple(middle - 1e-7), triple(middle + 1e-7)
    terms = []
    for box in ((low, high), thin, tiny):
        smooth = particle_images._interpolate(camera, box)
        assert smooth is not None
        assert smooth.coefficients.shape[1] == len(smooth.terms)
        terms.append(smooth.terms)
    assert len(terms[1]) < 0.7 * len(terms[0])
    assert terms[1][:, 2].max() < terms[0][:, 2].max()
    assert terms[2].tolist() == [[0, 0, 0]]
    found, exact = (find_paths(camera, np.tile(middle, (300, 1)), box) for box in (tiny, None))
    np.testing.assert_allclose(found.arriving, exact.arriving, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.solid_angle, exact.solid_angle, rtol=1e-7)


def test_points_outside_the_box_have_exact_paths() -> None:
    camera, (low, high) = camera_of("quick")
    points = points_in((low, high), 200)
    points[::7] += 1.01 * (np.asarray(high) - np.asarray(low))
    outside = np.arange(200) % 7 == 0
    found, exact = find_paths(camera, points, (low, high)), find_paths(camera, points)
    for one in SMOOTH:
        np.testing.assert_array_equal(getattr(found, one)[outside], getattr(exact, one)[outside])


@pytest.mark.parametrize("crossed", [True, False])
def test_some_boxes_have_no_polynomials_but_exact_paths(crossed: bool) -> None:
    """One that reaches through the wall, and one of 100 mm that begins 30 mm from a camera."""
    camera, (low, high) = camera_of("quick")
    box = (low[0], low[1], low[2] - 1000.0), high
    if not crossed:
        camera = replace(camera, wall=None, center_mm=(0.0, 0.0, low[2] - 30.0))
        box = (-50.0, -50.0, low[2]), (50.0, 50.0, low[2] + 100.0)
    assert particle_images._interpolate(camera, box) is None
    points = points_in(box, 300)
    found, exact = find_paths(camera, points, box), find_paths(camera, points)
    assert exact.valid.sum() > 0
    assert (exact.valid.sum() < 300) == crossed
    np.testing.assert_array_equal(found.valid, exact.valid)
    np.testing.assert_array_equal(found.solid_angle, exact.solid_angle)
