"""Images of particles: the lens and both renderers.

Each against its own law and against the other.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from dataclasses import replace
from typing import Any

import miepython
import numba
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.lens_distortion import Distortion
from sabench.geometry.refraction import trace_to_points, transmittance
from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.scenes.focusing import focus
from sabench.simulation.rendering import particles_splatted, particles_traced
from sabench.simulation.rendering.laser_sheet import LIGHT_M_S, PLANCK_J_S, fluence
from sabench.simulation.rendering.particle_images import (
    ParticleImages,
    diffract,
    diffraction_px,
    image_particles,
)
from sabench.simulation.rendering.particle_light import _angle_range, scatterers_of
from sabench.simulation.rendering.particles_traced import render
from sabench.utils.arrays import F64, I64
from sabench.worlds.library.size_lattice import lattice_diameters_mm, size_numbers

WAVELENGTH_MM = 532e-6


def make_scene(**changes: dict[str, Any] | None) -> Scene:
    """Return the quick scene with unequal, small images.

    Each table is updated with the given keys, or left out; a wall of another shape replaces it.
    """
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 110, "columns": 170}
    values["illumination"] |= {
        "pulse_energy_mj": 20.0,
        "thickness_mm": 30.0,
        "height_mm": 20.0,
        "scattering": "isotropic",
    }
    for table, update in changes.items():
        if update is None:
            del values[table]
        else:
            values[table] = update if "shape" in update else values[table] | update
    return parse_scene(values, "test")


def cloud(positions: F64, diameter_mm: float | F64 = 0.02) -> Particles:
    count = len(positions)
    return Particles(np.arange(count), positions, np.full(count, diameter_mm), np.zeros((count, 3)))


# The lens


def solid_angle_of(a: F64, b: F64, c: F64) -> F64:
    """Van Oosterom and Strackee's triangle of unit vectors (n, 3)."""
    triple = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    pairs = sum(np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return np.asarray(2.0 * np.arctan2(triple, 1.0 + pairs))


def caught_light(camera: Camera, points: F64, rings: int = 6, sectors: int = 24) -> F64:
    """Return the solid angle of the pupil at each point.

    It is weighted with the wall's transmission. The pupil is cut into small cells, and each is
    traced by itself.
    """

    def paths(radius: float, turn: float) -> tuple[F64, F64]:
        moved = camera.shifted(radius * math.cos(turn), radius * math.sin(turn))
        pinhole = np.asarray(moved.center_mm)
        found = trace_to_points(camera.wall, pinhole, points)
        return found.arriving, transmittance(camera.wall, pinhole, found.leaving)

    radii = np.linspace(0.0, camera.aperture_radius_mm, rings + 1)
    turns = np.linspace(0.0, 2.0 * np.pi, sectors + 1)
    total = np.zeros(len(points))
    for inner, outer in itertools.pairwise(radii):
        for first, last in itertools.pairwise(turns):
            a, b, c, d = (
                paths(r, t)[0]
                for r, t in ((inner, first), (outer, first), (outer, last), (inner, last))
            )
            passed = paths((inner + outer) / 2.0, (first + last) / 2.0)[1]
            total += passed * (solid_angle_of(a, b, c) + solid_angle_of(a, c, d))
    return (
        total * (2.0 * np.pi / sectors) / math.sin(2.0 * np.pi / sectors)
    )  # chords leave out a share of the disc


TILT = {
    "normal": [0.3, -0.2, 1.0],
    "layers": [
        {"name": "glass", "index": 1.52, "thickness_mm": 5.0},
        {"name": "gel", "index": 1.4, "thickness_mm": 3.0},
    ],
}
ROUND = {
    "shape": "cylinder",
    "axis_point_mm": [2.0, 0.0, 45.0],
    "axis": [0.1, 1.0, 0.05],
    "outer_radius_mm": 40.0,
    "layers": TILT["layers"],
    "fluid_index": 1.333,
}
VARIANTS: dict[str, dict[str, dict[str, Any] | None]] = {
    "flat": {},
    "tilted": {"wall": TILT},
    "distorted": {
        "cameras": {"distortion": {"k1": -60.0, "k2": 2000.0, "p1": 0.3, "p2": -0.2, "k3": 0.0}}
    },
    "air": {"wall": None},
    "round": {"wall": ROUND},
    "wide-open": {"cameras": {"f_number": 2.0}},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_photons_are_those_that_a_round_aperture_catches(variant: str) -> None:
    scene = make_scene(**VARIANTS[variant])
    particles = cloud(
        np.random.default_rng(2).uniform([-6.0, -4.0, 26.0], [6.0, 4.0, 34.0], (5, 3))
    )
    for camera in build_rig(scene).cameras[::3]:
        images = image_particles(scene, camera, particles, None)
        np.testing.assert_allclose(
            images.photons,
            images.intensity * caught_light(camera, particles.position_mm),
            rtol=0.01,
        )


def test_isotropic_particles_scatter_what_falls_on_them() -> None:
    scene, diameter = make_scene(), 0.03
    images = image_particles(
        scene, build_rig(scene).cameras[0], cloud(np.array([[1.0, 2.0, 30.0]]), diameter), None
    )
    fallen = (
        20.0 / (PLANCK_J_S * LIGHT_M_S / 532e-9 * 1e3) / (30.0 * 20.0) * np.pi * diameter**2 / 4.0
    )
    assert images.intensity[0] * 4.0 * np.pi == pytest.approx(fallen, rel=1e-12)


@pytest.mark.parametrize("f_number", [4.0, 16.0])
def test_mie_intensity_is_the_mean_over_the_lens(f_number: float) -> None:
    """The table's value at the lens's centre is the mean over the lens.

    Every point of the lens asks Mie's theory at its own angle.
    """
    scene, diameter = (
        make_scene(illumination={"scattering": "mie"}, cameras={"f_number": f_number}),
        float(lattice_diameters_mm(size_numbers(np.array([0.02])))[0]),
    )
    rig, particles = build_rig(scene), cloud(np.array([[0.5, -0.4, 30.5]]), diameter)
    scatterers = scatterers_of(scene, rig.cameras, 0)
    disc = np.random.default_rng(7).uniform(-1.0, 1.0, (1500, 2))
    disc = disc[np.hypot(*disc.T) < 1.0]
    light = fluence(scene.light, np.array([0.0, 0.0, 30.0]), particles.position_mm)[0]
    for camera in rig.cameras:
        angles = []
        for right, down in disc * camera.aperture_radius_mm:
            moved = camera.shifted(right, down)
            arriving = trace_to_points(
                moved.wall, np.asarray(moved.center_mm), particles.position_mm
            ).arriving[0]
            angles.append(
                math.acos(-arriving[0])
            )  # the laser runs along +X, the light towards the camera
        amplitudes = miepython.S1_S2(
            1.59 / 1.333, np.pi * 1.333 * diameter / WAVELENGTH_MM, np.cos(angles), norm="wiscombe"
        )
        raw = sum(np.abs(a) ** 2 for a in amplitudes) / (
            2.0 * (2.0 * np.pi * 1.333 / WAVELENGTH_MM) ** 2
        )
        found = image_particles(scene, camera, particles, scatterers).intensity[0]
        assert found == pytest.approx(raw.mean() * light, rel=0.02)


def test_the_table_holds_the_angles_of_all_light_that_is_caught_and_few_others() -> None:
    scene = make_scene(illumination={"scattering": "mie"}, cameras={"f_number": 2.0})
    cameras, rng = build_rig(scene).cameras, np.random.default_rng(3)
    corners = np.array(list(itertools.product((-0.5, 0.0, 0.5), repeat=3)))
    points = np.asarray(scene.volume.center_mm) + corners * np.asarray(scene.volume.size_mm)
    place = scene.volume.center_mm, scene.volume.size_mm, scene.light.direction
    found = _angle_range(*place, cameras)
    angles = []
    for camera in cameras:
        for turn in rng.uniform(0.0, 2.0 * np.pi, 30):  # the rim of the aperture
            edge = camera.aperture_radius_mm * np.array([math.cos(turn), math.sin(turn)])
            moved = camera.shifted(*edge)
            arriving = trace_to_points(moved.wall, np.asarray(moved.center_mm), points).arriving
            angles.append(np.arccos(-arriving[:, 0]))  # the laser runs along +X
    assert found[0] < np.min(angles)
    assert found[-1] > np.max(angles)
    assert np.ptp(found) < np.ptp(angles) + 0.3


@pytest.mark.parametrize("z_mm", [-200.0, 0.0, 100.0, 400.0, 1500.0])
def test_width_in_air_is_that_of_the_thin_lens(z_mm: float) -> None:
    f, number, distance, pitch, diameter = 85.0, 4.0, 103.0, 0.01, 0.05
    camera = Camera(
        name="camera_00",
        rows=90,
        columns=120,
        center_mm=(0.0, 0.0, -400.0),
        rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),
        principal_distance_mm=distance,
        pixel_mm=pitch,
        principal_point_px=(59.5, 44.5),
        distortion=Distortion(),
        focal_length_mm=f,
        f_number=number,
    )
    light = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    sigma = image_particles(
        light, camera, cloud(np.array([[0.0, 0.0, z_mm]]), diameter), None
    ).sigma_px[0]
    far = z_mm + 400.0
    image_at = 1.0 / (1.0 / f - 1.0 / far)  # where the point is sharp
    blur = f / number * abs(image_at - distance) / image_at
    airy = 2.44 * (distance / f) * number * WAVELENGTH_MM  # (1 + M) N lambda with 1 + M = v / f
    expected = math.sqrt(
        (diameter * distance / far / 4.0) ** 2 + airy**2 / (8 * 3.67) + (blur / 4.0) ** 2
    )
    assert sigma * pitch == pytest.approx(expected, rel=2e-4)


def test_shape_moves_the_image_by_its_width() -> None:
    scene = make_scene(wall=TILT)
    camera = build_rig(scene).cameras[1]
    particles = cloud(
        np.random.default_rng(3).uniform([-1.5, -1.0, 28.0], [1.5, 1.0, 32.0], (20, 3))
    )
    images = image_particles(scene, camera, particles, None)
    shape_mm, moves = images.shape_mm(camera, particles.position_mm), []
    for axis in (0, 1):
        step = 1e-2 * shape_mm[:, axis]
        there, back = (camera.project(particles.position_mm + s * step)[0] for s in (1.0, -1.0))
        moves.append((there - back) / 2e-2)
        np.testing.assert_allclose(
            np.einsum("ij,ij->i", shape_mm[:, axis], images.direction), 0.0, atol=1e-12
        )
    spread = sum(move[:, [0, 1, 0]] * move[:, [0, 1, 1]] for move in moves)
    assert np.abs(images.spread_px2[:, 2]).max() > 1e-4
    np.testing.assert_allclose(spread, images.spread_px2, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "forward", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
)
def test_width_does_not_depend_on_where_the_world_points(
    forward: tuple[float, float, float],
) -> None:
    scene = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    camera = replace(
        build_rig(scene).cameras[0],
        center_mm=(0.0, 0.0, 0.0),
        rotation=aimed_rotation(np.array(forward)),
    )
    upright = replace(camera, rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])))
    turned, plain = (
        image_particles(scene, c, cloud(540.0 * np.asarray(c.rotation)[2:]), None)
        for c in (camera, upright)
    )
    assert turned.sigma_px[0] == pytest.approx(plain.sigma_px[0], rel=1e-9)
    assert np.isfinite(turned.shape_mm(camera, 540.0 * np.asarray(camera.rotation)[2:])).all()


# Splatting


def spots(pixels: F64, photons: F64, sigma: F64) -> ParticleImages:
    count = len(pixels)
    zero, seen = np.zeros((count, 3)), np.ones(count, dtype=np.bool_)
    spread = sigma[:, None] ** 2 * [1.0, 1.0, 0.0]
    return ParticleImages(pixels, photons, sigma, seen, np.zeros(count), zero, spread)


SMALL = Camera(
    name="camera_00",
    rows=40,
    columns=60,
    center_mm=(0.0, 0.0, 0.0),
    rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),
    principal_distance_mm=50.0,
    pixel_mm=0.01,
    principal_point_px=(29.5, 19.5),
    distortion=Distortion(),
    focal_length_mm=50.0,
    f_number=8.0,
)


def centre_of_rounded(place: F64, sigma: float) -> F64:
    """Return the mean of a normal variable rounded to whole numbers.

    By the Fourier series of the saw tooth: narrow images are drawn to their pixel's centre.
    """
    k = np.arange(1, 30)[:, None]
    return np.asarray(
        place
        - np.sum(
            (-1.0) ** (k + 1)
            * np.sin(2 * np.pi * k * place)
            * np.exp(-2 * (np.pi * k * sigma) ** 2)
            / (np.pi * k),
            axis=0,
        )
    )


@pytest.mark.parametrize("sigma", [0.15, 0.5, 1.0, 2.3])
def test_splat_keeps_light_and_place(sigma: float) -> None:
    for place in np.random.default_rng(4).uniform([15.0, 15.0], [45.0, 25.0], (20, 2)):
        image = particles_splatted.render(
            SMALL, spots(place[None], np.array([1000.0]), np.array([sigma]))
        )
        assert image.sum() == pytest.approx(1000.0, rel=2e-5)
        centroid = [
            (image.sum(axis=0) @ np.arange(60)) / image.sum(),
            (image.sum(axis=1) @ np.arange(40)) / image.sum(),
        ]
        np.testing.assert_allclose(centroid, centre_of_rounded(place, sigma), rtol=0, atol=1e-4)
        if sigma >= 1.0:
            np.testing.assert_allclose(centroid, place, rtol=0, atol=1e-4)


def test_splat_pixel_is_the_integral_of_a_gaussian_over_it() -> None:
    place, sigma = np.array([20.37, 11.81]), 0.8
    image = particles_splatted.render(
        SMALL, spots(place[None], np.array([500.0]), np.array([sigma]))
    )
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    for row, column in ((12, 20), (11, 22), (10, 19)):
        x, y = np.meshgrid(column + fine, row + fine)
        value = (
            np.mean(np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * sigma**2)))
            * 500.0
            / (2 * np.pi * sigma**2)
        )
        assert image[row, column] == pytest.approx(value, rel=1e-5)


def test_splat_moves_with_its_particle() -> None:
    sigma, photons = np.array([0.7]), np.array([300.0])
    first = particles_splatted.render(SMALL, spots(np.array([[20.3, 14.6]]), photons, sigma))
    moved = particles_splatted.render(SMALL, spots(np.array([[27.3, 18.6]]), photons, sigma))
    np.testing.assert_allclose(moved[8:36, 12:50], first[4:32, 5:43], rtol=0, atol=1e-9)
    mirrored = particles_splatted.render(
        SMALL, spots(np.array([[59.0 - 20.3, 39.0 - 14.6]]), photons, sigma)
    )
    np.testing.assert_allclose(mirrored[::-1, ::-1], first, rtol=0, atol=1e-9)


def test_splat_is_additive_and_cut_at_the_border() -> None:
    rng = np.random.default_rng(5)
    places, photons, sigma = (
        rng.uniform(-6.0, 66.0, (400, 2)),
        rng.uniform(0.0, 9.0, 400),
        rng.uniform(0.3, 2.0, 400),
    )
    whole = particles_splatted.render(SMALL, spots(places, photons, sigma))
    parts = [
        particles_splatted.render(SMALL, spots(places[i::3], photons[i::3], sigma[i::3]))
        for i in range(3)
    ]
    np.testing.assert_allclose(sum(parts), whole, rtol=0, atol=1e-9)
    larger = particles_splatted.render(
        replace(SMALL, rows=80, columns=110), spots(places + np.array([20.0, 30.0]), photons, sigma)
    )
    np.testing.assert_allclose(whole, larger[30:70, 20:80], rtol=0, atol=1e-9)


def test_splat_of_nothing_is_dark() -> None:
    nowhere = spots(
        np.array([[math.nan, math.nan], [500.0, 3.0]]),
        np.array([0.0, 9.0]),
        np.array([math.nan, 0.5]),
    )
    assert not particles_splatted.render(SMALL, nowhere).any()
    assert not particles_splatted.render(
        SMALL, spots(np.empty((0, 2)), np.empty(0), np.empty(0))
    ).any()


def test_brightest_pixel_is_where_the_particle_projects() -> None:
    camera = replace(SMALL, principal_point_px=(0.0, 0.0))
    image = particles_splatted.render(
        camera, spots(camera.project([[0.0, 0.0, 100.0]])[0], np.array([100.0]), np.array([0.5]))
    )
    assert image.argmax() == 0


# Mitsuba against splatting


def isolated(
    camera: Camera, depth_mm: tuple[float, float], pitch: int, seed: int
) -> tuple[F64, I64]:
    """Return particles behind the wall whose images lie on a jittered lattice.

    And the lattice's nearest pixels (column, row).
    """
    rng = np.random.default_rng(seed)
    column, row = np.meshgrid(
        np.arange(pitch, camera.columns - pitch, pitch),
        np.arange(pitch, camera.rows - pitch, pitch),
    )
    pixels = np.column_stack([column.ravel(), row.ravel()])
    rays = camera.back_project(pixels + rng.uniform(-1.0, 1.0, pixels.shape))
    z = rng.uniform(*depth_mm, len(pixels))
    return rays.origins_mm + rays.directions * (
        (z - rays.origins_mm[:, 2]) / rays.directions[:, 2]
    )[:, None], pixels


def moments(image: F64, pixels: I64, half: int) -> tuple[F64, F64]:
    """Light and centroid offset (n, 2) in windows around pixels (column, row)."""
    offset = np.arange(-half, half + 1)
    windows = image[pixels[:, 1, None, None] + offset[:, None], pixels[:, 0, None, None] + offset]
    light = windows.sum(axis=(1, 2))
    return light, np.stack(
        [windows.sum(axis=1) @ offset, windows.sum(axis=2) @ offset], axis=1
    ) / light[:, None]


def assert_same_picture(scene: Scene, camera: Camera, positions: F64, pixels: I64) -> None:
    """Compare light and centroids of isolated particles between both renderers."""
    images = image_particles(scene, camera, cloud(positions), None)
    traced = moments(render(camera, images, positions, 16) * camera.etendue(), pixels, 6)
    formula = moments(particles_splatted.render(camera, images), pixels, 6)
    shift = traced[1] - formula[1]
    assert np.abs(shift.mean(axis=0)).max() < 0.01
    assert np.abs(shift).max() < 0.02
    np.testing.assert_allclose(traced[0], formula[0], rtol=0.02)
    assert traced[0].sum() == pytest.approx(formula[0].sum(), rel=5e-3)


@pytest.mark.parametrize("number", [0, 3])
@pytest.mark.parametrize("variant", VARIANTS)
def test_rays_and_formulas_make_the_same_picture(variant: str, number: int) -> None:
    scene = make_scene(**VARIANTS[variant])
    camera = build_rig(scene).cameras[number]
    positions, pixels = isolated(
        camera, (27.0, 33.0) if variant != "wide-open" else (29.5, 30.5), 13, number
    )
    assert len(positions) >= 70
    assert_same_picture(scene, camera, positions, pixels)


def crowd(camera: Camera) -> tuple[F64, ParticleImages]:
    """Make images of 600 particles in a layer of a micrometre, eight of them in each pixel."""
    rng = np.random.default_rng(6)
    rays = camera.back_project(rng.uniform([20.0, 15.0], [29.0, 23.0], (600, 2)))
    z = rng.uniform(30.0, 30.001, 600)
    along = (z - rays.origins_mm[:, 2]) / rays.directions[:, 2]
    positions = rays.origins_mm + rays.directions * along[:, None]
    return positions, image_particles(make_scene(), camera, cloud(positions), None)


def test_no_particle_hides_another() -> None:
    camera = build_rig(make_scene()).cameras[1]
    positions, images = crowd(camera)
    traced = render(camera, images, positions, 49) * camera.etendue()
    formula = particles_splatted.render(camera, images)
    assert traced.sum() == pytest.approx(formula.sum(), rel=1e-4)
    np.testing.assert_allclose(traced, formula, rtol=0.0, atol=0.003 * formula.max())


def test_portions_of_a_cloud_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded by rendering some particles at a time."""
    camera = build_rig(make_scene()).cameras[1]
    positions, images = crowd(camera)
    whole = render(camera, images, positions, 4)
    monkeypatch.setattr(particles_traced, "_AT_ONCE", 5000)
    np.testing.assert_allclose(render(camera, images, positions, 4), whole, rtol=1e-5)


def test_rays_carry_the_light_of_near_and_large_particles() -> None:
    """The entry point into a ball of glow does not count as its distance.

    The ball reaches far in front of its centre here (0.7 of 40 mm).
    """
    camera = replace(
        SMALL,
        rows=70,
        columns=110,
        principal_distance_mm=1.7,
        focal_length_mm=1.65,
        principal_point_px=(54.5, 34.5),
    )
    positions, pixels = isolated(camera, (39.0, 41.0), 16, 4)
    images = image_particles(
        make_scene(wall=None, illumination={"thickness_mm": 1e4}),
        camera,
        cloud(positions, 0.8),
        None,
    )
    traced, formula = (
        moments(picture, pixels, 6)[0]
        for picture in (
            render(camera, images, positions, 16) * camera.etendue(),
            particles_splatted.render(camera, images),
        )
    )
    assert traced.sum() == pytest.approx(formula.sum(), rel=2e-3)


def test_rays_of_a_strongly_distorted_lens_meet_the_formulas() -> None:
    camera = replace(
        SMALL,
        rows=110,
        columns=215,
        principal_distance_mm=1.7,
        focal_length_mm=1.65,
        principal_point_px=(107.0, 55.0),
    )
    camera = replace(camera, distortion=Distortion(k1=-0.3))
    plain = isolated(
        replace(camera, distortion=Distortion(), columns=300, principal_point_px=(149.5, 55.0)),
        (50.0, 60.0),
        16,
        3,
    )[0]
    nodes = np.rint(camera.project(plain)[0])
    inside = camera.project(plain)[1] & camera.contains(nodes, -7.0)
    positions, pixels = plain[inside], nodes[inside].astype(np.int64)
    images = image_particles(
        make_scene(wall=None, illumination={"thickness_mm": 1e4}),
        camera,
        cloud(positions, 0.8),
        None,
    )
    traced, formula = (
        moments(picture, pixels, 5)
        for picture in (
            render(camera, images, positions, 16) * camera.etendue(),
            particles_splatted.render(camera, images),
        )
    )
    assert len(positions) > 50
    assert np.abs(pixels[:, 0] - 107).max() > 90
    assert np.abs(traced[1] - formula[1]).max() < 0.02
    np.testing.assert_allclose(traced[0], formula[0], rtol=0.02)


def test_corners_that_the_lens_does_not_reach_are_dark() -> None:
    lens = Distortion(k1=-0.3)
    camera = replace(
        SMALL,
        rows=90,
        columns=130,
        principal_distance_mm=0.4,
        focal_length_mm=0.39,
        principal_point_px=(66.0, 44.0),
        distortion=lens,
    )
    positions = np.random.default_rng(8).uniform([-40.0, -40.0, 40.0], [40.0, 40.0, 60.0], (60, 3))
    scene = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    images = image_particles(scene, camera, cloud(positions, 3.0), None)
    picture, corner = (
        render(camera, images, positions, 4),
        np.hypot(*np.mgrid[-44:46, -66:64]) > 32.0,
    )
    assert np.isfinite(picture).all()
    assert picture.max() > 0.0
    assert not picture[corner].any()


def test_render_of_nothing_is_dark() -> None:
    scene = make_scene()
    camera = build_rig(scene).cameras[0]
    empty = cloud(np.empty((0, 3)))
    picture = render(camera, image_particles(scene, camera, empty, None), empty.position_mm, 4)
    assert picture.shape == (110, 170)
    assert not picture.any()


def test_the_same_render_twice_gives_the_same_bytes() -> None:
    scene = make_scene()
    camera = build_rig(scene).cameras[2]
    positions = isolated(camera, (27.0, 33.0), 20, 1)[0]
    images = image_particles(scene, camera, cloud(positions), None)
    np.testing.assert_array_equal(
        render(camera, images, positions, 4), render(camera, images, positions, 4)
    )


# Ellipses


def slanted(pixels: F64, photons: float, spread: tuple[float, float, float]) -> ParticleImages:
    count = len(pixels)
    images = spots(pixels, np.full(count, photons), np.ones(count))
    return replace(images, spread_px2=np.tile(spread, (count, 1)))


@pytest.mark.parametrize(
    "spread", [(0.7, 0.4, 0.3), (0.25, 2.0, -0.5), (2.0, 0.25, 0.01), (0.667, 0.667, 0.65)]
)
def test_a_pixel_of_an_ellipse_is_the_integral_over_it(spread: tuple[float, float, float]) -> None:
    place, fine = np.array([20.37, 11.81]), (np.arange(300) + 0.5) / 300 - 0.5
    image = particles_splatted.render(SMALL, slanted(place[None], 500.0, spread))
    inverse = np.linalg.inv([[spread[0], spread[2]], [spread[2], spread[1]]])
    scale = 500.0 * math.sqrt(np.linalg.det(inverse)) / (2.0 * np.pi)
    for row, column in ((12, 20), (11, 21), (13, 21), (10, 20)):
        x, y = np.meshgrid(column + fine - place[0], row + fine - place[1])
        form = inverse[0, 0] * x**2 + 2.0 * inverse[0, 1] * x * y + inverse[1, 1] * y**2
        expected = scale * np.exp(-form / 2.0).mean()
        assert image[row, column] == pytest.approx(expected, rel=2e-3, abs=2e-3)
    assert image.sum() == pytest.approx(500.0, rel=2e-5)


def oblique_camera(f_number: float) -> tuple[Scene, Camera]:
    """A camera at 45 degrees to the wall, whose refraction is strongly astigmatic."""
    scene = make_scene(cameras={"f_number": f_number}, illumination={"thickness_mm": 1e4})
    camera = build_rig(scene).cameras[0]
    camera = replace(camera, center_mm=(-330.0, -330.0, -440.0))
    turned = aim(camera, np.array([0.0, 0.0, 200.0]))
    return scene, focus(turned, np.array([0.0, 0.0, 200.0]), None)


def test_the_blur_of_an_oblique_view_is_that_of_rays_through_the_lens() -> None:
    """Trace rays from points all over the aperture to the sensor, one by one."""
    scene, camera = oblique_camera(4.0)
    points = np.array([[0.0, 0.0, 200.0], [1.0, -0.5, 212.0], [-1.5, 1.0, 191.0]])
    images = image_particles(scene, camera, cloud(points), None)
    disc = np.random.default_rng(3).uniform(-1.0, 1.0, (6000, 2))
    disc = disc[np.hypot(*disc.T) < 1.0] * camera.aperture_radius_mm
    hits = []
    for right, down in disc:
        moved = camera.shifted(right, down)
        # a point at the focus's distance is at rest on the sensor
        back = np.array([right, down]) * camera.focal_px / camera.focus_mm
        hits.append(moved.project(points)[0] + back)
    round_part = diffraction_px(camera, 532.0) ** 2  # the disc of 20 um is small beside it
    for k in range(len(points)):
        found = np.cov(np.array(hits)[:, k].T)
        across, down, both = images.spread_px2[k] - round_part * np.array([1.0, 1.0, 0.0])
        scale = max(found[0, 0], found[1, 1])
        np.testing.assert_allclose(
            [across, down, both], [found[0, 0], found[1, 1], found[0, 1]], atol=0.05 * scale + 0.03
        )
    long, short = np.linalg.eigvalsh(images.spread_px2[1][[[0, 2], [2, 1]]])[::-1]
    assert long > 2.0 * short


@pytest.mark.parametrize("z_mm", [191.0, 200.0, 212.0])
def test_rays_and_formulas_make_the_same_ellipses(z_mm: float) -> None:
    scene, camera = oblique_camera(8.0)
    position = np.array([[0.4, -0.3, z_mm]])
    images = image_particles(scene, camera, cloud(position), None)
    traced = render(camera, images, position, 100) * camera.etendue()
    formula = particles_splatted.render(camera, images)
    rows, columns = np.mgrid[: camera.rows, : camera.columns]
    found = []
    for image in (traced, formula):
        weights = image / image.sum()
        x, y = columns - (weights * columns).sum(), rows - (weights * rows).sum()
        found.append([(weights * term).sum() for term in (x * x, y * y, x * y)])
        np.testing.assert_allclose(
            [(weights * columns).sum(), (weights * rows).sum()], images.pixel[0], atol=2e-3
        )
    np.testing.assert_allclose(found[0], found[1], atol=2e-3 * max(found[1]))
    assert traced.sum() == pytest.approx(formula.sum(), rel=2e-3)
    assert z_mm == 200.0 or abs(images.spread_px2[0, 2]) > 0.2


@pytest.mark.parametrize("f_number", [2.0, 5.6, 11.0, 32.0])
def test_diffraction_adds_its_variance_however_narrow_it_is(f_number: float) -> None:
    """A sampled Gaussian of 0.43 px has two thirds of it, one of 0.2 px next to nothing."""
    camera = replace(SMALL, f_number=f_number)
    image = np.zeros((61, 41))
    image[30, 20] = 5.0
    blurred, sigma = diffract(camera, image, 532.0), diffraction_px(camera, 532.0)
    rows, columns = np.mgrid[-30:31, -20:21]
    assert blurred.min() >= 0.0
    assert blurred.sum() == pytest.approx(5.0)
    for offset in (rows, columns):
        assert np.sum(blurred * offset**2) / 5.0 == pytest.approx(sigma**2, rel=1e-3)


@pytest.mark.parametrize(
    ("across", "down", "tilt"),
    [(0.75, 0.75, 0.0), (0.75, 0.75, 0.0019), (0.2, 0.1, 0.5), (1.5, 2.0, -0.95), (3.0, 2.0, 0.99)],
)
def test_windows_are_integrals_of_a_normal_density(across: float, down: float, tilt: float) -> None:
    """Against differences of SciPy's distribution function of two correlated variables."""
    center, covariance = np.array([30.3, 18.1]), tilt * across * down
    spread = np.array([[across**2, down**2, covariance]])
    one, zero = np.ones(1), np.zeros((1, 3))
    images = ParticleImages(center[None], one, one, one > 0.0, one, zero, spread)
    found = particles_splatted.render(SMALL, images)
    matrix = [[across**2, covariance], [covariance, down**2]]
    columns, rows = np.meshgrid(np.arange(SMALL.columns + 1), np.arange(SMALL.rows + 1))
    corners = np.stack([columns, rows], axis=-1) - 0.5
    share = multivariate_normal(center, matrix).cdf(corners)
    exact = np.diff(np.diff(share, axis=0), axis=1)
    left_out = 2e-5 * found.max()  # beyond the window
    np.testing.assert_allclose(found, exact, rtol=0, atol=2e-8 + left_out)


def test_images_do_not_depend_on_the_number_of_threads_or_order() -> None:
    """Bytes of one thread and of two; and the sum of two halves, as light adds up."""
    rng, count = np.random.default_rng(3), 300
    pixel = rng.uniform(-6.0, [66.0, 46.0], (count, 2))
    sigma, tilt = rng.uniform(0.3, 3.0, (count, 2)), rng.uniform(-0.5, 0.5, count)
    spread = np.column_stack([sigma**2, tilt * sigma.prod(axis=1)])
    one, zero = np.ones(count), np.zeros((count, 3))
    images = ParticleImages(pixel, one, one, one > 0.0, one, zero, spread)
    numba.set_num_threads(1)
    try:
        alone = particles_splatted.render(SMALL, images)
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    np.testing.assert_array_equal(particles_splatted.render(SMALL, images), alone)
    halves = []
    for half in (slice(None, None, 2), slice(1, None, 2)):
        part = ParticleImages(
            pixel[half], one[half], one[half], one[half] > 0, one[half], zero[half], spread[half]
        )
        halves.append(particles_splatted.render(SMALL, part))
    np.testing.assert_allclose(sum(halves), alone, rtol=1e-12, atol=1e-15)
