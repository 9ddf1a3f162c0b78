"""Reflected images of particles against rays that are followed from face to face."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes import Scene, build_rig
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering.light_routes import Route, reflections
from sabench.simulation.rendering.particle_images import image_particles
from sabench.utils.arrays import F64
from tests.helpers.particle_scenes import cloud, make_scene

REAR = (Layer("glass", 1.52, 4.0), Layer("acrylic", 1.49, 6.0))
FRONT = [
    {"name": "glass", "index": 1.52, "thickness_mm": 5.0},
    {"name": "gel", "index": 1.4, "thickness_mm": 3.0},
]
WALL: dict[str, Any] = {"layers": FRONT, "normal": [0.1, -0.05, 1.0], "depth_mm": 60.0}


def scene_of(**wall: Any) -> Scene:
    rear = [
        {"name": one.name, "index": one.index, "thickness_mm": one.thickness_mm} for one in REAR
    ]
    light = {"thickness_mm": 1e3}
    return make_scene(wall=WALL | {"rear": rear} | wall, illumination=light)


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
    return {
        "water": [*into, (68.0, 1.333, 0.0)],
        "glass": [*into, (68.0, 1.333, 1.52), (72.0, 1.52, 0.0), (68.0, 1.52, 1.333)],
        "acrylic": [
            *into,
            (68.0, 1.333, 1.52),
            (72.0, 1.52, 1.49),
            (78.0, 1.49, 0.0),
            (72.0, 1.49, 1.52),
            (68.0, 1.52, 1.333),
        ],
        "front glass": [(0.0, 1.0, 1.52), (5.0, 1.52, 0.0), (0.0, 1.52, 0.0), *into[1:]],
        "front both": [
            (0.0, 1.0, 1.52),
            (5.0, 1.52, 1.4),
            (8.0, 1.4, 0.0),
            (5.0, 1.4, 1.52),
            (0.0, 1.52, 0.0),
            *into[1:],
        ],
        "front gel": [*into[:2], (8.0, 1.4, 0.0), (5.0, 1.4, 0.0), into[2]],
    }[kind]


KINDS = ("front glass", "front both", "front gel", "water", "glass", "acrylic")  # as listed


@pytest.mark.parametrize("kind", KINDS)
def test_a_ray_from_the_reflected_image_meets_the_particle(kind: str) -> None:
    scene = scene_of()
    points = np.random.default_rng(1).uniform([-4.0, -3.0, 20.0], [4.0, 3.0, 50.0], (4, 3))
    for camera in build_rig(scene).cameras[::3]:
        route = routes_of(camera)[KINDS.index(kind)]
        images = image_particles(scene, camera, cloud(points), None, (), route)
        for point, pixel, seen in zip(points, images.pixel, images.direction, strict=True):
            place, direction = follow(camera, pixel, moves_of(kind))
            miss = np.linalg.norm(np.cross(point - place, direction))
            assert miss < 1e-6
            at_particle = route.at_particle(seen[None])[0]
            np.testing.assert_allclose(at_particle, direction, atol=1e-9)


def test_reflected_shares_are_fresnel_s() -> None:
    camera = build_rig(scene_of()).cameras[0]
    assert isinstance(camera.wall, Wall)
    normal = np.asarray(camera.wall.normal)
    found = [float(route.reflected(normal[None])[0]) for route in routes_of(camera)]

    def share(before: float, after: float) -> float:
        return ((before - after) / (before + after)) ** 2

    expected = [
        share(1.0, 1.52) * share(1.52, 1.4),
        share(1.0, 1.52) * share(1.4, 1.333),
        share(1.52, 1.4) * share(1.4, 1.333),
        share(1.333, 1.52),
        share(1.52, 1.49),
        share(1.49, 1.0),
    ]
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
        views.append(
            camera_view.render(Frames(scene, build_rig(scene), 3, renderer).at(0), 1).photons
        )
    traced, splatted, plain = views
    extra = splatted - plain
    assert extra.min() > -1e-9
    assert 0.02 < extra.sum() / plain.sum() < 0.06
    assert traced.sum() == pytest.approx(splatted.sum(), rel=5e-3)
    faint = extra > 0.2 * extra.max()
    assert np.abs(traced - splatted)[faint].max() < 0.1 * extra.max()
