"""Refocusing on surfaces against the plane sweep, and against rays met with a cylinder."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter, map_coordinates

from sabench.algorithms.refocus import refocus_on_surface, refocus_sum
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.surfaces import Cylinder, Plane, Surface
from sabench.utils.arrays import F32, F64
from tests.unit.algorithms.refocus.test_synthetic_aperture import TILTED, make_camera

GRID = Grid((-3.0, -2.0, 36.0), (0.05, 0.05, 0.05), (161, 81, 121))
PLACE = {"center_mm": (0.0, 0.0, 40.0), "pixel_mm": 0.1}


CAMERAS = tuple(
    make_camera(x, y, TILTED, at=(0.0, 0.0, 40.0))
    for x, y in ((0.0, 0.0), (-90.0, 20.0), (80.0, -40.0), (10.0, 95.0))
)


def smooth_images(seed: int = 2) -> F32:
    noise = np.random.default_rng(seed).random((len(CAMERAS), 110, 140))
    images = np.stack([gaussian_filter(one, 3.0) for one in noise])
    return np.asarray((images - images.min()) / np.ptp(images), dtype=np.float32)


def texture(u: F64, v: F64) -> F64:
    return np.asarray(0.5 + 0.3 * np.sin(6.0 * u) * np.cos(4.0 * v) + 0.15 * np.cos(8.0 * v + u))


def refocused(surface: Surface, images: F32, join: str = "additive") -> F32:
    return refocus_on_surface(images, CAMERAS, surface.points_mm(), join).values  # type: ignore[arg-type]


def test_a_plane_of_constant_z_is_that_of_the_sweep() -> None:
    images = smooth_images()
    swept = refocus_sum(images, CAMERAS, replace(GRID, shape=(1, 81, 121)))[0] / len(CAMERAS)
    plane = Plane(center_mm=(0.0, 0.0, 36.0), size_mm=(6.0, 4.0), pixel_mm=0.05)
    made = refocus_on_surface(images, CAMERAS, plane.points_mm(), "additive")
    seen = made.views == len(CAMERAS)  # the sweep takes the others as dark
    assert seen.mean() > 0.9
    assert_allclose(made.values[seen], swept[seen], atol=3e-4)


def test_a_tilted_plane_is_interpolated_from_the_stack_of_planes() -> None:
    """The difference is the sweep's bilinear step: it falls with the square of the voxel."""
    images = smooth_images()
    plane = Plane(**PLACE, size_mm=(5.5, 3.5), turn_deg=(15.0, 40.0, 0.0))
    points = plane.points_mm()
    made = refocused(plane, images)
    rms = []
    for voxel in (0.1, 0.05):
        shape = (161, round(4.0 / voxel) + 1, round(6.0 / voxel) + 1)
        grid = Grid(GRID.low_mm, (voxel, voxel, 0.05), shape)
        stack = refocus_sum(images, CAMERAS, grid) / len(CAMERAS)
        x, y, z = grid.to_voxels(points.reshape(-1, 3)).T
        assert np.ptp(z) > 70.0
        between = map_coordinates(stack, [z, y, x], order=3).reshape(points.shape[:2])
        rms.append(float(np.sqrt(np.mean((made - between) ** 2))))
    assert rms[0] > 3.0 * rms[1]
    assert rms[1] < 1e-3


@pytest.mark.parametrize("radius", [3.0, -3.0])
def test_a_texture_on_a_cylinder_comes_out_as_it_is(radius: float) -> None:
    """Images come from rays met with the cylinder; the best plane blurs the same texture."""
    axis_z = 40.0 + radius
    images = np.stack([_photograph(camera, radius, axis_z) for camera in CAMERAS])
    surface = Cylinder(**PLACE, size_mm=(5.6, 4.0), radius_mm=radius)
    expected = texture(*np.meshgrid(*surface.axes_mm))
    off = refocused(surface, images) - expected
    assert np.abs(off).max() < 5e-3
    points = surface.points_mm()
    for z in np.linspace(points[..., 2].min(), points[..., 2].max(), 9):
        flat = points * [1.0, 1.0, 0.0] + [0.0, 0.0, z]
        blurred = refocus_on_surface(images, CAMERAS, flat, "additive").values - expected
        assert np.mean(blurred**2) > 50.0**2 * np.mean(off**2)


def _photograph(camera: Camera, radius: float, axis_z: float) -> F32:
    """Trace each pixel's ray to its meeting with the front of the cylinder."""
    column, row = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    rays = camera.back_project(np.column_stack([column.ravel(), row.ravel()]).astype(np.float64))
    start = rays.origins_mm[:, ::2] - [0.0, axis_z]
    along = rays.directions[:, ::2]
    a, b = (along**2).sum(axis=1), (along * start).sum(axis=1)
    c = (start**2).sum(axis=1) - radius**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    distance = (-b - np.sign(radius) * root) / a
    hit = rays.origins_mm + distance[:, None] * rays.directions
    angle = np.arctan2(np.sign(radius) * hit[:, 0], np.sign(radius) * (axis_z - hit[:, 2]))
    seen = texture(radius * angle, hit[:, 1])
    return np.asarray(seen.reshape(camera.rows, camera.columns), dtype=np.float32)


@pytest.mark.parametrize(
    ("join", "expected"),
    [
        ("additive", 0.575),
        ("multiplicative", (0.2 * 0.4 * 0.8 * 0.9) ** 0.25),
        ("dark", 1.0 - (0.8 * 0.6 * 0.2 * 0.1) ** 0.25),
        ("minimum", 0.2),
        ("maximum", 0.9),
        ("median", 0.6),
    ],
)
def test_views_are_joined_as_they_say(join: str, expected: float) -> None:
    """Uniform images of four levels: each join is a number that is known."""
    levels = np.array([0.2, 0.4, 0.8, 0.9], dtype=np.float32)
    images = np.broadcast_to(levels[:, None, None], (4, 110, 140)).copy()
    plane = Plane(**PLACE, size_mm=(2.0, 1.0))
    assert_allclose(refocused(plane, images, join), expected, rtol=1e-5)


def test_a_camera_counts_where_it_shows_the_front() -> None:
    images = smooth_images()
    plane = Plane(**PLACE, size_mm=(2.0, 1.0)).points_mm()
    behind = Plane(**PLACE, size_mm=(2.0, 1.0), turn_deg=(0.0, 180.0, 0.0)).points_mm()
    masked = np.zeros(images.shape, dtype=np.bool_)
    masked[2] = True
    assert (refocus_on_surface(images, CAMERAS, plane, "additive").views == 4).all()
    assert (refocus_on_surface(images, CAMERAS, plane, "additive", masked).views == 3).all()
    nothing = refocus_on_surface(images, CAMERAS, behind, "additive")
    assert not nothing.views.any()
    assert np.isnan(nothing.values).all()
    tube = Cylinder(**PLACE, size_mm=(7.0, 2.0), radius_mm=1.2).points_mm()
    seen = refocus_on_surface(images, CAMERAS, tube, "additive").views
    assert seen[:, 35].min() == 4
    assert seen[:, [0, -1]].max() == 0
