"""Bubbles, drops and bodies before a diffuser, against ray optics and Mitsuba's path tracer."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from sabench.api import Material
from sabench.api.truth import NOTHING, Bubbles, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes.illumination import Backlight, Lamp, Lighting
from sabench.simulation.rendering.bubble_stage import Lights, Tank
from sabench.simulation.rendering.bubbles_traced import Exposed, render
from sabench.simulation.rendering.pixel_truth import see
from sabench.utils import backend
from sabench.utils.arrays import F64

GLASS = Layer("glass", 1.52, 8.0)
WALL = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (GLASS,), 1.333, 100.0)
TANK = Tank(WALL, (GLASS,))
CENTER = np.array([0.0, 0.0, 50.0])
FULL = 1000.0


def camera(
    rows: int = 48,
    columns: int = 64,
    *,
    wall: Wall | None = WALL,
    focal: float = 3000.0,
    x: float = 0.0,
) -> Camera:
    place, eye = (x, 0.0, -550.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    middle, ideal = ((columns - 1) / 2.0, (rows - 1) / 2.0), Distortion()
    lens = 1.0 / (100.0 / focal + 1.0 / 588.0)  # sharp in the middle of the tank
    return Camera(
        "camera_00", rows, columns, place, eye, focal * 0.01, 0.01, middle, ideal, lens, 64.0, wall
    )


def bubbles(
    centers: Sequence[Sequence[float]],
    axes: Sequence[Sequence[float]],
    index: float = 1.0,
    turn: F64 | None = None,
    speed: Sequence[float] = (0.0, 0.0, 0.0),
) -> Bubbles:
    count = len(centers)
    turns = np.tile(np.eye(3), (count, 1, 1)) if turn is None else turn
    places, sizes = (np.array(one).reshape(-1, 3) for one in (centers, axes))
    return Bubbles(np.arange(count), places, sizes, turns, np.tile(speed, (count, 1)), index)


NONE = bubbles([], [])


def diffuser(half: float = 60.0, z: float = 130.0) -> Backlight:
    # no diffraction
    return Backlight(
        center_mm=(0.0, 0.0, z), size_mm=(2.0 * half, 2.0 * half), exposure=0.5, wavelength_nm=1.0
    )


def shot(
    lens: Camera,
    what: Bubbles,
    light: Backlight | None = None,
    *,
    tank: Tank = TANK,
    error: float = 0.003,
    seed: int = 1,
    **more: Any,
) -> Exposed:
    lights = Lights(light or diffuser(), None, CENTER, FULL)
    return render(lens, tank, what, more.pop("bodies", ()), lights, error, seed, **more)


def test_nothing_in_the_way_is_the_exposure_that_was_asked_for() -> None:
    seen = shot(camera(), NONE)
    middle = seen.photons[20:28, 28:36].mean()
    assert middle / FULL == pytest.approx(0.5, rel=0.004)  # besides what both walls send to and fro
    assert seen.error < 0.003


def profile_by_hand(b: F64, half_angle: float) -> F64:
    """Trace a ball of air before a round diffuser by Snell's law at parts b of its radius."""

    def turned(way: F64, normal: F64, ratio: float) -> F64 | None:
        cosine = -float(way @ normal)
        square = 1.0 - ratio**2 * (1.0 - cosine**2)
        return None if square < 0.0 else ratio * way + (ratio * cosine - np.sqrt(square)) * normal

    def fresnel(way: F64, normal: F64, ratio: float) -> float:
        bent = turned(way, normal, ratio)
        if bent is None:
            return 1.0
        ci, ct = -float(way @ normal), -float(bent @ normal)
        s, p = (ratio * ci - ct) / (ratio * ci + ct), (ci - ratio * ct) / (ci + ratio * ct)
        return 0.5 * (s * s + p * p)

    out = []
    for part in b:
        place, way = np.array([part, -np.sqrt(1.0 - part**2)]), np.array([0.0, 1.0])
        reflected = way - 2.0 * float(way @ place) * place
        share = fresnel(way, place, 1.333)
        light = share * (np.arctan2(abs(reflected[0]), reflected[1]) < half_angle)
        inside, left = turned(way, place, 1.333), 1.0 - share
        for _ in range(10):
            if inside is None:
                break
            place = place - 2.0 * float(inside @ place) * inside
            share = fresnel(inside, -place, 1.0 / 1.333)
            leaving = turned(inside, -place, 1.0 / 1.333)
            if leaving is not None:
                light += (
                    left * (1.0 - share) * (np.arctan2(abs(leaving[0]), leaving[1]) < half_angle)
                )
            left *= share
            inside = inside - 2.0 * float(inside @ place) * place
        out.append(light)
    return np.array(out)


def crossings(values: F64, places: F64, level: float) -> F64:
    """Return the positions where a curve crosses a level, linear between its points."""
    k = np.flatnonzero((values[:-1] - level) * (values[1:] - level) < 0.0)
    return np.asarray(
        places[k] + (level - values[k]) / (values[k + 1] - values[k]) * (places[k + 1] - places[k])
    )


@pytest.mark.slow
def test_rim_and_bright_spot_of_a_bubble_are_where_ray_optics_has_them() -> None:
    """The diffuser is far behind, so that its half angle is the same for all of the bubble."""
    deep, radius, half, z = replace(WALL, depth_mm=3000.0), 8.0, 1000.0, 3030.0
    lens, ball = camera(120, 120, wall=deep), bubbles([[0.0, 0.0, 50.0]], [[radius] * 3])
    seen = shot(lens, ball, diffuser(half, z), tank=Tank(deep, (GLASS,)), error=0.005)
    truth = see(lens, ball)
    edge = float(np.linalg.norm(truth.contour[0] - truth.pixel[0], axis=1).mean())
    fine = (np.arange(960) + 0.5) / 8.0 - 0.5
    part = np.linspace(0.0, 0.999999, 4000)
    sharp = profile_by_hand(part, float(np.arctan(half / (z - 50.0))))
    x, y = np.meshgrid((fine - truth.pixel[0, 0]) / edge, (fine - truth.pixel[0, 1]) / edge)
    fine_image = np.interp(np.hypot(x, y), part, sharp, right=1.0)
    by_hand = fine_image.reshape(120, 8, 120, 8).mean(axis=(1, 3))
    row, column = np.mgrid[0:120, 0:120]
    away = np.hypot(column - truth.pixel[0, 0], row - truth.pixel[0, 1])
    rendered = seen.photons / np.median(seen.photons[away > 1.3 * edge])
    off = np.minimum(abs(column - truth.pixel[0, 0]), abs(row - truth.pixel[0, 1]))
    near = (off < 3.0) & (away < 1.25 * edge)  # the diffuser is square
    bins = np.arange(0.5, 1.2 * edge, 0.5)
    curves = [
        np.array([image[near & (np.abs(away - q) < 0.75)].mean() for q in bins])
        for image in (rendered, by_hand)
    ]
    places = [crossings(curve, bins, 0.5) for curve in curves]
    assert len(places[0]) == len(places[1]) == 2
    np.testing.assert_allclose(places[0], places[1], atol=0.25)
    assert places[1][1] - places[1][0] > 15.0
    flat = np.abs(bins[:, None] - places[1]).min(axis=1) > 3.0
    np.testing.assert_allclose(curves[0][flat], curves[1][flat], atol=0.02)


def by_path_tracer(lens: Camera, what: Bubbles, light: Backlight, samples: int) -> tuple[F64, F64]:
    """Return the same picture and its standard error by Mitsuba's `path` integrator."""
    import trimesh

    mi = backend.mitsuba()

    def look(origin: Sequence[float], target: list[float], up: float = 1.0) -> Any:
        view = {"origin": list(origin), "target": target, "up": [0.0, up, 0.0]}
        return mi.ScalarTransform4f().look_at(**view)

    def plane(to: Any, half: float, **more: Any) -> dict[str, Any]:
        scaled = to @ mi.ScalarTransform4f().scale([half, half, 1.0])
        return {"type": "rectangle", "to_world": scaled, **more}

    def surface(before: float, after: float) -> dict[str, Any]:
        return {"type": "dielectric", "ext_ior": before, "int_ior": after}

    glow = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    half = light.size_mm[0] / 2.0
    shapes: dict[str, Any] = {"light": plane(look(light.center_mm, [0.0] * 3), half, emitter=glow)}
    faces = (0.0, 1.0, 1.52), (8.0, 1.52, 1.333), (108.0, 1.333, 1.52), (116.0, 1.52, 1.0)
    for z, *indices in faces:
        to = look([0.0, 0.0, z], [0.0, 0.0, z - 1.0])
        shapes[f"face_{z:.0f}"] = plane(to, 400.0, bsdf=surface(*indices))
    for n in range(len(what)):
        bsdf = surface(1.333, what.index)
        if np.ptp(what.semi_axes_mm[n]) < 1e-9:
            place, radius = what.center_mm[n].tolist(), float(what.semi_axes_mm[n, 0])
            ball = {"type": "sphere", "center": place, "radius": radius, "bsdf": bsdf}
            shapes[f"ball_{n}"] = ball
            continue
        sphere = trimesh.creation.icosphere(subdivisions=6)
        points = sphere.vertices @ np.linalg.inv(what.to_ball[n]).T + what.center_mm[n]
        normals = sphere.vertices @ what.to_ball[n]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(bsdf)
        mesh = mi.Mesh(
            f"ball_{n}", len(points), len(sphere.faces), has_vertex_normals=True, props=properties
        )
        values = mi.traverse(mesh)
        values["vertex_positions"] = points.astype(np.float32).ravel()
        values["faces"] = sphere.faces.astype(np.uint32).ravel()
        values["vertex_normals"] = normals.astype(np.float32).ravel()
        values.update()
        shapes[f"ball_{n}"] = mesh
    film = {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    sensor = {
        "type": "perspective",
        "to_world": look(lens.center_mm, [lens.center_mm[0], 0.0, 0.0], -1.0),
        "fov": float(2.0 * np.degrees(np.arctan(lens.columns / 2.0 / lens.focal_px))),
        "fov_axis": "x",
        "film": film | {"width": lens.columns, "height": lens.rows},
        "sampler": {"type": "independent"},
    }
    path = {"type": "path", "max_depth": 48, "rr_depth": 100}
    scene = mi.load_dict({"type": "scene", "integrator": path, "sensor": sensor, **shapes})
    parts = [
        np.array(mi.render(scene, spp=samples // 8, seed=seed))[..., 0].astype(np.float64)
        for seed in range(8)
    ]
    return np.mean(parts, axis=0), np.asarray(np.std(parts, axis=0, ddof=1) / np.sqrt(8.0))


LEANING = np.array([[[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]])
CASES = {
    "bubbles": bubbles(
        [[-2.0, 0.0, 45.0], [1.5, 1.0, 60.0], [1.0, -1.0, 40.0]], [[2.0] * 3, [1.5] * 3, [0.7] * 3]
    ),
    "drop of oil": bubbles([[0.0, 0.0, 50.0]], [[3.0] * 3], 1.47),
    "spheroid": bubbles([[0.5, 0.0, 50.0]], [[3.5, 2.0, 3.5]], turn=LEANING),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_another_integrator_makes_the_same_picture(name: str) -> None:
    """Pixel by pixel, by its standard errors."""
    lens = camera(20, 30, focal=1125.0, x=3.0)
    seen = shot(lens, CASES[name], error=0.003)
    radiance, error = by_path_tracer(lens, CASES[name], diffuser(), 4096)
    scale = FULL * 0.5 / TANK.straight() / float(lens.etendue().max())
    expected, sigma = radiance * scale * lens.etendue(), error * scale * lens.etendue()
    least = np.maximum(sigma, 1e-3 * expected.max())
    score = (seen.photons - expected) / np.hypot(least, 0.004 * seen.photons)
    assert abs(float((seen.photons - expected).mean())) < 0.004 * expected.mean()
    assert np.median(np.abs(score)) < 1.0
    assert np.quantile(np.abs(score), 0.98) < 4.0


@pytest.mark.slow
def test_errors_are_as_large_as_they_are_said_to_be() -> None:
    """Two renders of different seeds differ by their errors, which keep the limit."""
    what = CASES["bubbles"]
    one, other = (shot(camera(), what, error=0.01, seed=seed) for seed in (1, 5000))
    np.testing.assert_array_equal(one.photons, shot(camera(), what, error=0.01, seed=1).photons)
    assert one.error <= 0.01
    mean = np.maximum(0.5 * (one.photons + other.photons), 0.02 * 0.5 * FULL)
    off = np.abs(one.photons - other.photons) / mean
    # of the mean modulus of a normal difference
    expected = np.sqrt(2.0) * np.sqrt(2.0 / np.pi) * 0.5 * (one.error + other.error)
    assert 0.5 < off.mean() / expected < 2.0
    assert shot(camera(), what, error=0.005).error <= 0.005 < one.error


def test_a_drop_in_air_needs_no_walls() -> None:
    lens = camera(wall=None)
    seen = shot(lens, bubbles([[0.0, 0.0, 50.0]], [[2.0] * 3], 1.333), tank=Tank(None))
    (center,), _ = lens.project(np.array([[0.0, 0.0, 50.0]]))
    column, row = (int(one) for one in center)
    middle = seen.photons[row - 1 : row + 2, column - 1 : column + 2].mean() / FULL
    assert seen.photons[2:6, 2:6].mean() / FULL == pytest.approx(0.5, rel=1e-3)
    straight = (1.0 - ((1.333 - 1.0) / (1.333 + 1.0)) ** 2) ** 2
    assert middle == pytest.approx(0.5 * straight, rel=0.02)
    assert seen.photons.min() / FULL < 0.1


@pytest.mark.slow
def test_a_black_body_hides_what_is_behind_it_and_a_lamp_shows_it() -> None:
    import trimesh

    upright = trimesh.transformations.rotation_matrix(np.pi / 2.0, [1.0, 0.0, 0.0])
    cylinder = trimesh.creation.cylinder(2.0, 60.0, sections=256, transform=upright)
    faces = np.asarray(cylinder.faces, dtype=np.int64)
    solid = Solid(np.asarray(cylinder.vertices) + CENTER, faces)
    lens = camera()
    dark = shot(lens, NONE, bodies=[(solid, Material(reflectance=0.0))])
    truth = see(lens, NONE, [solid])
    on = truth.number < NOTHING
    assert 0.2 < on.mean() < 0.5
    inner = np.roll(on, 2, axis=1) & np.roll(on, -2, axis=1) & on
    assert dark.photons[inner].max() < 1e-6 * FULL
    assert dark.photons[~(np.roll(on, 2, axis=1) | np.roll(on, -2, axis=1))].min() > 0.45 * FULL
    middle = truth.depth_mm[24, 32]
    assert middle == pytest.approx(48.0, abs=5e-3)  # half a pixel beside its axis
    assert truth.path_mm[24, 32] == pytest.approx(550.0 + 48.0, abs=0.01)
    lamp = Lighting(lamps=(Lamp(center_mm=(0.0, 0.0, -500.0)),), exposure=0.6, wavelength_nm=1.0)
    lights, white = Lights(None, lamp, CENTER, FULL), [(solid, Material(reflectance=1.0))]
    lit = render(lens, TANK, NONE, white, lights, 0.003, 1)
    # 2 mm before the volume's centre, facing the lamp
    assert lit.photons[24, 31:33].mean() / FULL == pytest.approx(0.6, rel=0.02)
    near = cv2.dilate(on.astype(np.uint8), np.ones((13, 13), np.uint8)) > 0
    assert not near.all()
    # beyond the reach of diffraction, rounding is left
    assert lit.photons[~near].max() < 1e-9


@pytest.mark.slow
def test_a_bubble_out_of_focus_is_blurred_by_the_aperture_s_disc() -> None:
    """A disc of radius r adds r^2 / 4 to the variance along each axis."""
    what, lens = bubbles([[0.0, 0.0, 95.0]], [[0.6] * 3]), camera(32, 32)
    spread, offset = [], np.arange(32) - 15.5
    for f_number in (64.0, 1.4):
        image = shot(replace(lens, f_number=f_number), what, error=3e-4).photons
        dark = np.mean(image[:4]) - image
        assert abs(np.sum(dark.sum(axis=0) * offset) / dark.sum()) < 0.3
        spread.append(np.sum(dark.sum(axis=0) * offset**2) / dark.sum())
    apparent = 550.0 + 8.0 / 1.52 + 87.0 / 1.333
    radius = 3000.0 * lens.focal_length_mm / 2.8 * (1.0 / lens.focus_mm - 1.0 / apparent)
    assert spread[1] - spread[0] == pytest.approx(radius**2 / 4.0, rel=0.25)


def moving(x_mm_s: float) -> Bubbles:
    return bubbles([[0.0, 0.0, 50.0]], [[0.6] * 3], speed=(x_mm_s, 0.0, 0.0))


def test_a_moving_bubble_is_sharp_in_an_instant() -> None:
    one, other = (shot(camera(20, 30), moving(v), error=0.05).photons for v in (0.0, 500.0))
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_a_moving_bubble_is_smeared() -> None:
    lens = camera(20, 40)
    sharp, smeared = (shot(lens, moving(v), exposure_s=2e-3, error=0.001) for v in (0.0, 1000.0))
    dark = [(0.5 * FULL - image.photons)[4:16, 6:34].sum(axis=0) for image in (sharp, smeared)]
    assert dark[1].sum() == pytest.approx(dark[0].sum(), rel=0.06)  # the same shadow
    column = np.arange(6, 34)
    middle = [np.sum(column * one) / one.sum() for one in dark]
    spread = [np.sum((column - m) ** 2 * d) / d.sum() for m, d in zip(middle, dark, strict=True)]
    (left, right), _ = lens.project(np.array([[-1.0, 0.0, 50.0], [1.0, 0.0, 50.0]]))
    # that of 2 mm of way
    assert spread[1] - spread[0] == pytest.approx((right[0] - left[0]) ** 2 / 12.0, rel=0.08)
    assert middle[1] == pytest.approx(middle[0], abs=0.15)


def test_surfaces_are_met_to_single_precision_from_far_away() -> None:
    """A ray that starts 30 m before a bubble near the origin, against double precision."""
    mi = backend.mitsuba()
    from sabench.simulation.rendering.bubble_integrator import _on_bubble

    center, to_ball = np.array([0.4, -0.3, 1.2]), np.diag([2.0, 1.25, 1.6])
    aims = center + np.random.default_rng(5).uniform(-0.15, 0.15, (50, 3))
    sent = np.array([300.0, -200.0, -30000.0])
    ways = (aims - sent) / np.linalg.norm(aims - sent, axis=1)[:, None]
    starts = np.float32(aims - 30000.0 * ways).astype(np.float64)
    ways = np.float32(ways).astype(np.float64)
    device = SimpleNamespace(
        centers=mi.Point3f(center.tolist()), rows=[mi.Vector3f(row) for row in to_ball.tolist()]
    )
    columns = [np.ascontiguousarray(each.T, dtype=np.float32) for each in (starts, ways)]
    ray = mi.Ray3f(mi.Point3f(columns[0]), mi.Vector3f(columns[1]))
    for inside, sign in ((False, -1.0), (True, 1.0)):
        at, normal = _on_bubble(device, ray, mi.UInt32(0), mi.Bool(inside), mi.Bool(True))
        p, d = (starts - center) @ to_ball, ways @ to_ball
        a, b, c = (np.einsum("ij,ij->i", *two) for two in ((d, d), (p, d), (p, p)))
        step = (sign * np.sqrt(b * b - a * (c - 1.0)) - b) / a
        expected = starts + step[:, None] * ways
        outwards = (expected - center) @ to_ball**2
        outwards /= np.linalg.norm(outwards, axis=1)[:, None]
        np.testing.assert_allclose(np.array(at).T, expected, atol=1e-5)
        np.testing.assert_allclose(np.array(normal).T, outwards, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tank", "half"), [(TANK, 60.0), (Tank(replace(WALL, depth_mm=None)), 400.0)]
)
def test_rays_given_up_between_walls_find_nothing(
    tank: Tank, half: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a wall behind, light that is reflected totally may come from the diffuser."""
    from sabench.simulation.rendering import bubble_integrator

    grid = [[x, y, 60.0] for x in (-4.0, 0.0, 4.0) for y in (-3.0, 0.0, 3.0)]
    what = bubbles(grid, [[1.5] * 3] * len(grid))
    asked: list[Any] = []
    fast = shot(camera(), what, diffuser(half), tank=tank)

    def never(_device: Any, _ray: Any, _here: Any, passed: Any) -> Any:
        asked.append(passed)
        return passed < 0.0

    monkeypatch.setattr(bubble_integrator, "_is_lost", never)
    slow = shot(camera(), what, diffuser(half), tank=tank)
    assert asked
    np.testing.assert_allclose(slow.photons, fast.photons, rtol=1e-5, atol=1e-6 * FULL)
