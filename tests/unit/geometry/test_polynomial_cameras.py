"""Camera models other than the refractive pinhole. Fits, inverses, and reconstruction with them."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.refocus.synthetic_aperture import refocus_sum
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.polynomial_cameras import fit_planes, fit_soloff
from sabench.geometry.projective_camera import fit_projective
from sabench.geometry.triangulation import intersect, triangulate
from sabench.scenes import build_rig
from sabench.simulation.in_memory import simulate
from sabench.utils.arrays import F64
from tests.conftest import pinholes
from tests.helpers.calibration_cases import calibration_scene
from tests.helpers.particle_scenes import make_scene
from tests.helpers.refusals import refused

Z_PLANES = np.linspace(15.0, 55.0, 6)


def lattice(step: float = 4.0) -> F64:
    axis = np.arange(-20.0, 20.1, step)
    x, y, z = np.meshgrid(axis, axis, Z_PLANES)
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()])


def fitted(camera: Camera) -> list[CameraModel]:
    points = lattice()
    pixels = camera.project(points)[0]
    by_plane = [points[:, 2] == z for z in Z_PLANES]
    size = (camera.name, camera.rows, camera.columns)
    planes = fit_planes(*size, [points[own] for own in by_plane], [pixels[own] for own in by_plane])
    fits = [fit(*size, points, pixels) for fit in (fit_projective, fit_soloff)]
    return [camera, *fits, planes]


@pytest.mark.parametrize(("kind", "most"), [(1, 0.35), (2, 0.01), (3, 0.1)])
def test_what_is_lost_without_refraction(kind: int, most: float) -> None:
    """At D = 0.3: a projective map 0.16 px, Soloff's 0.01 px, planes 8 mm apart 0.06 px."""
    camera = build_rig(calibration_scene()).cameras[0]
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-20.0, 20.0, (1000, 2)), rng.uniform(15.0, 55.0, 1000)])
    off = fitted(camera)[kind].project(points)[0] - camera.project(points)[0]
    assert 0.0005 < np.linalg.norm(off, axis=1).mean() < most


def test_a_camera_in_air_is_projective() -> None:
    camera = build_rig(calibration_scene(wall=None)).cameras[1]
    model = fitted(camera)[1]
    points = lattice(3.0)
    assert_allclose(model.project(points)[0], camera.project(points)[0], atol=1e-8)
    assert_allclose(model.center_mm, camera.center_mm, atol=1e-5)
    rays, true = model.back_project([[100.0, 900.0]]), camera.back_project([[100.0, 900.0]])
    assert_allclose(rays.directions, true.directions, atol=1e-9)


@pytest.mark.parametrize("kind", [0, 1, 2, 3])
def test_lines_of_sight_lead_back(kind: int) -> None:
    """Those of polynomials up to the bend of a line between its ends."""
    model = fitted(build_rig(calibration_scene()).cameras[3])[kind]
    points = lattice(10.0)
    pixels, valid = model.project(points)
    assert valid.all()
    there = np.column_stack([model.carry(points, 33.0), np.full(len(points), 33.0)])
    assert_allclose(model.project(there)[0], pixels, atol=1e-6)
    rays = model.back_project(pixels)
    assert rays.valid.all()
    length = (points[:, 2] - rays.origins_mm[:, 2]) / rays.directions[:, 2]
    near = rays.origins_mm + rays.directions * length[:, None]
    assert np.abs(near - points).max() < (0.02 if kind > 1 else 1e-6)
    inside = model.contains(np.array([[0.0, 0.0], [-1.0, 5.0], [5.0, 1e6], [np.nan, 0.0]]))
    assert inside.tolist() == [True, False, False, False]


@pytest.mark.parametrize("kind", [0, 2])
def test_points_come_back_from_their_images(kind: int) -> None:
    models = [fitted(camera)[kind] for camera in build_rig(calibration_scene()).cameras[:4]]
    points = lattice(10.0)
    pixels = np.stack([model.project(points)[0] for model in models])
    pixels[2:, 5] = np.nan
    pixels[1:, 7] = np.nan
    found = triangulate(models, pixels)
    assert np.isnan(found[7]).all()
    known = np.arange(len(points)) != 7
    assert np.abs(found[known] - points[known]).max() < 1e-6
    assert np.abs(intersect(models, pixels)[known] - points[known]).max() < (0.02 if kind else 1e-6)


def test_points_do_not_depend_on_the_size_of_pixels() -> None:
    cameras = build_rig(calibration_scene()).cameras[:4]
    points = lattice(10.0)
    pixels = np.stack([camera.project(points)[0] for camera in cameras])
    pixels += np.random.default_rng(0).standard_normal(pixels.shape)
    coarse = [
        replace(
            camera,
            pixel_mm=100.0 * camera.pixel_mm,
            principal_point_px=(
                camera.principal_point_px[0] / 100.0,
                camera.principal_point_px[1] / 100.0,
            ),
        )
        for camera in cameras
    ]
    assert_allclose(triangulate(coarse, pixels / 100.0), triangulate(cameras, pixels), atol=1e-6)


def test_points_that_do_not_determine_a_model_are_refused() -> None:
    points, rng = lattice(), np.random.default_rng(0)
    flat = points[points[:, 2] == Z_PLANES[0]]
    pixels = rng.random((len(flat), 2))
    for fit in (fit_projective, fit_soloff):
        with refused("cam"):
            fit("cam", 10, 10, flat, pixels)
    with refused("cam", "1"):
        fit_planes("cam", 10, 10, [flat], [pixels])
    with refused("cam: frame 1", "6"):
        higher = flat[:3] + np.array([0.0, 0.0, 5.0])
        fit_planes("cam", 10, 10, [flat, higher], [pixels, pixels[:3]])


@pytest.mark.slow
def test_reconstruction_runs_on_polynomials() -> None:
    """Refocusing agrees as far as the cameras do."""
    seen = simulate(make_scene(particles={"count": 40}), seed=2).observation
    low = np.asarray(seen.grid.low_mm)
    high = low + (np.asarray(seen.grid.shape[::-1]) - 1) * np.asarray(seen.grid.voxel_mm)
    axes = [np.linspace(a - 0.5, b + 0.5, 7) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    models = tuple(
        fit_soloff(camera.name, camera.rows, camera.columns, points, camera.project(points)[0])
        for camera in pinholes(seen.cameras)
    )
    light = seen.images.astype(np.float32)
    exact, other = (refocus_sum(light, cameras, seen.grid) for cameras in (seen.cameras, models))
    assert np.abs(exact - other).max() < 0.03 * exact.max()
    assert replace(seen, cameras=models).cameras == models


def test_a_mirrored_or_turned_camera_has_the_same_centre() -> None:
    """Pixels that define the centre lie symmetrically on the sensor."""
    camera = build_rig(calibration_scene()).cameras[0]
    points, last = lattice(), np.array([camera.columns - 1.0, camera.rows - 1.0])
    pixels, size = camera.project(points)[0], (camera.rows, camera.columns)
    centre = fit_soloff(camera.name, *size, points, pixels).center_mm
    for mirror in ([True, False], [False, True]):
        image = np.where(mirror, last - pixels, pixels)
        assert_allclose(fit_soloff(camera.name, *size, points, image).center_mm, centre, rtol=1e-7)
    turned = fit_soloff(camera.name, *size[::-1], points, pixels[:, ::-1]).center_mm
    assert_allclose(turned, centre, rtol=1e-7)


# the volume is about 300 mm in front of the camera
MATRIX = np.array([[900, 12, 310, 9e4], [-8, 870, 240, 7e4], [0.05, -0.03, 1, 300]])


def points_of(count: int) -> F64:
    return np.random.default_rng(3).uniform(-20.0, 20.0, (count, 3))


def pixels_of(points: F64) -> F64:
    image = np.column_stack([points, np.ones(len(points))]) @ MATRIX.T
    return np.asarray(image[:, :2] / image[:, 2:])


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_a_fit_does_not_depend_on_the_unit_of_length(unit: float) -> None:
    points = points_of(30)
    found = fit_projective("one", 480, 640, unit * points, pixels_of(points))
    others = points_of(60)[30:]
    assert_allclose(found.project(unit * others)[0], pixels_of(others), atol=1e-8)


def test_the_memory_of_a_fit_grows_with_the_points_and_not_their_square() -> None:
    """A square matrix of the 2,000 equations alone would take 32 MB."""
    points = points_of(1000)
    tracemalloc.start()
    try:
        fit_projective("one", 480, 640, points, pixels_of(points))
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 8e6
