"""Images of particles: their profiles, sizes and rings."""

import itertools
import math
from dataclasses import replace
from typing import Any

import miepython
import numpy as np
import pytest
from scipy.constants import c, h
from scipy.special import j1

from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.refraction import trace_to_points, transmittance
from sabench.scenes import build_rig
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.lamps import fluence
from sabench.simulation.rendering.particle_images import diffract, diffraction_px, image_particles
from sabench.simulation.rendering.particle_light import _angle_range, scatterers_of
from sabench.simulation.rendering.particles_splatted import render_with_rings
from sabench.utils.arrays import F64
from sabench.worlds.tracers import lattice_diameters_mm, size_numbers
from tests.helpers.particle_scenes import (
    SMALL,
    TILT,
    VARIANTS,
    cloud,
    make_scene,
    oblique_camera,
    spots,
)

WAVELENGTH_MM = 532e-6


def solid_angle_of(a: F64, b: F64, c: F64) -> F64:
    """Van Oosterom and Strackee's triangle of unit vectors (n, 3)."""
    triple = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    pairs = sum(np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return np.asarray(2.0 * np.arctan2(triple, 1.0 + pairs))


def caught_light(camera: Camera, points: F64, rings: int = 6, sectors: int = 24) -> F64:
    """Return the pupil's solid angle by cells, weighted with the wall's transmission."""

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
            rim = (inner, first), (outer, first), (outer, last), (inner, last)
            a, b, c, d = (paths(*corner)[0] for corner in rim)
            passed = paths((inner + outer) / 2.0, (first + last) / 2.0)[1]
            total += passed * (solid_angle_of(a, b, c) + solid_angle_of(a, c, d))
    # chords leave out a share of the disc
    return total * (2.0 * np.pi / sectors) / math.sin(2.0 * np.pi / sectors)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("variant", VARIANTS)
def test_photons_are_those_that_a_round_aperture_catches(variant: str) -> None:
    scene = make_scene(**VARIANTS[variant])
    points = np.random.default_rng(2).uniform([-6.0, -4.0, 26.0], [6.0, 4.0, 34.0], (5, 3))
    for camera in build_rig(scene).cameras[::3]:
        images = image_particles(scene, camera, cloud(points), None)
        expected = images.intensity * caught_light(camera, points)
        np.testing.assert_allclose(images.photons, expected, rtol=0.01)


def test_isotropic_particles_scatter_what_falls_on_them() -> None:
    scene, diameter = make_scene(), 0.03
    particle = cloud(np.array([[1.0, 2.0, 30.0]]), diameter)
    images = image_particles(scene, build_rig(scene).cameras[0], particle, None)
    photons = 20.0 / (h * c / 532e-9 * 1e3)
    fallen = photons / (30.0 * 20.0) * np.pi * diameter**2 / 4.0
    assert images.intensity[0] * 4.0 * np.pi == pytest.approx(fallen, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("f_number", [4.0, 16.0])
def test_mie_intensity_is_the_mean_over_the_lens(f_number: float) -> None:
    """The table's value, next to Mie's theory at the angle of every point of the lens."""
    scene = make_scene(illumination={"scattering": "mie"}, cameras={"f_number": f_number})
    diameter = float(lattice_diameters_mm(size_numbers(np.array([0.02])))[0])
    rig, particles = build_rig(scene), cloud(np.array([[0.5, -0.4, 30.5]]), diameter)
    scatterers = scatterers_of(scene, rig.cameras, 0)
    disc = np.random.default_rng(7).uniform(-1.0, 1.0, (1500, 2))
    disc = disc[np.hypot(*disc.T) < 1.0]
    light = fluence(scene.light, np.array([0.0, 0.0, 30.0]), particles.position_mm)[0]
    for camera in rig.cameras:
        angles = []
        for right, down in disc * camera.aperture_radius_mm:
            moved = camera.shifted(right, down)
            pinhole = np.asarray(moved.center_mm)
            arriving = trace_to_points(moved.wall, pinhole, particles.position_mm).arriving[0]
            # the laser runs along +X, the light towards the camera
            angles.append(math.acos(-arriving[0]))
        wavenumber = 2.0 * np.pi * 1.333 / WAVELENGTH_MM
        size = wavenumber * diameter / 2.0
        amplitudes = miepython.S1_S2(1.59 / 1.333, size, np.cos(angles), norm="wiscombe")
        raw = sum(np.abs(a) ** 2 for a in amplitudes) / (2.0 * wavenumber**2)
        found = image_particles(scene, camera, particles, scatterers).intensity[0]
        assert found == pytest.approx(raw.mean() * light, rel=0.02)


def test_the_table_holds_the_angles_of_the_light_that_is_caught() -> None:
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


@pytest.mark.parametrize("z_mm", [-200.0, 100.0, 1500.0])
def test_width_in_air_is_that_of_the_thin_lens(z_mm: float) -> None:
    f, number, distance, pitch, diameter = 85.0, 4.0, 103.0, 0.01, 0.05
    place: dict[str, Any] = {"center_mm": (0.0, 0.0, -400.0), "principal_distance_mm": distance}
    camera = replace(SMALL, pixel_mm=pitch, focal_length_mm=f, f_number=number, **place)
    light = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    particle = cloud(np.array([[0.0, 0.0, z_mm]]), diameter)
    sigma = image_particles(light, camera, particle, None).sigma_px[0]
    far = z_mm + 400.0
    image_at = 1.0 / (1.0 / f - 1.0 / far)  # where the point is sharp
    blur = f / number * abs(image_at - distance) / image_at
    airy = 2.44 * (distance / f) * number * WAVELENGTH_MM  # (1 + M) N lambda with 1 + M = v / f
    size = diameter * distance / far
    expected = math.sqrt((size / 4.0) ** 2 + airy**2 / (8 * 3.67) + (blur / 4.0) ** 2)
    assert sigma * pitch == pytest.approx(expected, rel=2e-4)


def test_shape_moves_the_image_by_its_width() -> None:
    scene = make_scene(wall=TILT)
    camera = build_rig(scene).cameras[1]
    points = np.random.default_rng(3).uniform([-1.5, -1.0, 28.0], [1.5, 1.0, 32.0], (20, 3))
    images = image_particles(scene, camera, cloud(points), None)
    shape_mm, moves = images.shape_mm(camera, points), []
    for axis in (0, 1):
        step = 1e-2 * shape_mm[:, axis]
        there, back = (camera.project(points + s * step)[0] for s in (1.0, -1.0))
        moves.append((there - back) / 2e-2)
        along = np.einsum("ij,ij->i", shape_mm[:, axis], images.direction)
        np.testing.assert_allclose(along, 0.0, atol=1e-12)
    spread = sum(move[:, [0, 1, 0]] * move[:, [0, 1, 1]] for move in moves)
    assert np.abs(images.spread_px2[:, 2]).max() > 1e-4
    np.testing.assert_allclose(spread, images.spread_px2, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "forward", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0)]
)
def test_width_does_not_depend_on_world_axes(forward: tuple[float, float, float]) -> None:
    scene = make_scene(wall=None, illumination={"thickness_mm": 1e4})
    upright, camera = (
        replace(
            build_rig(scene).cameras[0], center_mm=(0.0, 0.0, 0.0), rotation=aimed_rotation(way)
        )
        for way in (np.array([0.0, 0.0, 1.0]), np.array(forward))
    )
    turned, plain = (
        image_particles(scene, c, cloud(540.0 * np.asarray(c.rotation)[2:]), None)
        for c in (camera, upright)
    )
    assert turned.sigma_px[0] == pytest.approx(plain.sigma_px[0], rel=1e-9)
    assert np.isfinite(turned.shape_mm(camera, 540.0 * np.asarray(camera.rotation)[2:])).all()


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
        spread = images.spread_px2[k] - round_part * np.array([1.0, 1.0, 0.0])
        exact = [found[0, 0], found[1, 1], found[0, 1]]
        np.testing.assert_allclose(spread, exact, atol=0.05 * max(exact[:2]) + 0.03)
    long, short = np.linalg.eigvalsh(images.spread_px2[1][[[0, 2], [2, 1]]])[::-1]
    assert long > 2.0 * short


@pytest.mark.parametrize("f_number", [2.0, 11.0, 32.0])
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


LARGE = replace(SMALL, rows=120, columns=140, principal_point_px=(69.5, 59.5), f_number=16.0)


def airy(place: F64, shape: tuple[int, int]) -> F64:
    """Integrate the pattern over pixels, by 15 x 15 points in each."""
    fine = ((np.arange(15) + 0.5) / 15 - 0.5)[:, None, None, None]
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    radius = np.hypot(columns - place[0] + fine, rows - place[1] + fine.reshape(1, 15, 1, 1))
    x = np.pi * np.maximum(radius, 1e-9) * LARGE.pixel_mm / (532e-6 * 16.0)
    share = (np.pi * LARGE.pixel_mm / (532e-6 * 16.0)) ** 2 / (4.0 * np.pi)
    return np.asarray(((2.0 * j1(x) / x) ** 2).mean(axis=(0, 1)) * share)


def picture(place: tuple[float, float], sigma: float) -> F64:
    """Render a point of that width, in px, and the rings around it."""

    def render(camera: Camera) -> F64:
        fine = SMALL.pixel_mm / camera.pixel_mm
        pixel, width = (np.array(place) + 0.5) * fine - 0.5, np.array([sigma * fine])
        return particles_splatted.render(camera, spots(pixel[None], np.array([1000.0]), width))

    return render_with_rings(LARGE, 532.0, render)


@pytest.mark.parametrize("place", [(69.5, 59.5), (70.13, 58.84), (68.0, 60.0)])
def test_the_image_of_a_point_is_airy_s_pattern(place: tuple[float, float]) -> None:
    found = picture(place, diffraction_px(LARGE, 532.0))
    expected = 1000.0 * airy(np.array(place), found.shape)
    assert np.abs(found - expected).max() < 0.01 * expected.max()
    rows, columns = np.mgrid[:120, :140]
    radius = np.hypot(columns - place[0], rows - place[1])
    for ring in (3.0, 5.0, 10.0, 20.0):
        light = expected[radius > ring].sum()
        assert found[radius > ring].sum() == pytest.approx(light, rel=0.05, abs=6.0)


def test_a_wide_image_stays_nearly_as_it_is() -> None:
    point = spots(np.array([[69.5, 59.5]]), np.array([1000.0]), np.array([6.0]))
    image, found = particles_splatted.render(LARGE, point), picture((69.5, 59.5), 6.0)
    assert np.abs(found - image).max() < 0.06 * image.max()
    assert found.sum() == pytest.approx(image.sum(), rel=0.05)


def test_both_renderers_add_the_rings() -> None:
    scene = make_scene(cameras={"airy_rings": True}, particles={"count": 6})
    plain = make_scene(particles={"count": 6})
    rig, found = build_rig(scene), []
    for each, renderer in ((scene, "mitsuba"), (scene, "splat"), (plain, "splat")):
        view = camera_view.render_camera_view(Frames(each, rig, 1, renderer).at(0), 0)
        found.append(view.photons)
    traced, splatted, gaussian = found
    assert np.abs(traced - splatted).max() < 0.03 * splatted.max()
    assert traced.sum() == pytest.approx(splatted.sum(), rel=0.02)
    dark = gaussian < 1e-6 * gaussian.max()
    assert gaussian[dark].sum() < 1e-4 * gaussian.sum()
    assert splatted[dark].sum() > 0.01 * splatted.sum()
