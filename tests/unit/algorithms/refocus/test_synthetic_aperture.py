"""Refocusing against a second implementation, and between both back ends."""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from sabench.algorithms.refocus import (
    cpu_kernels,
    refocus_by_shifts,
    refocus_log2,
    refocus_sum,
    synthetic_aperture,
)
from sabench.algorithms.refocus.rectification import CUBIC, LINEAR, coefficients_of, resample
from sabench.algorithms.refocus.slabs import (
    DEVIATION_PX,
    deviation_px,
    make_slab,
    rectifying_maps,
    slabs,
)
from sabench.geometry.camera import Camera, aim
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.utils.arrays import F32, F64
from tests.helpers import cameras

FLOOR = 0.05
FLAT = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.52, 5.0),), 1.333)
TILTED = replace(FLAT, normal=(0.28, 0.0, 0.96))
BROWN = Distortion(-0.4, 2.0, 2e-3, -3e-3, 0.0)
GRID = Grid((-5.0, 0.7, 40.0), (0.06, 0.06, 0.5), (9, 151, 190))


def make_camera(
    x: float, y: float, wall: Wall | None, lens: Distortion = BROWN, **changes: Any
) -> Camera:
    values = {"rows": 110, "columns": 140, "principal_point_px": (66.0, 47.0), "wall": wall}
    values |= {"rotation": cameras.ALONG_Z, "principal_distance_mm": 60.0, "distortion": lens}
    at = changes.pop("at", (1.0, 5.0, 42.0))
    return aim(cameras.make_camera(center_mm=(x, y, -300.0), **values | changes), at)


def even(level: float, count: int) -> F32:
    return np.full((count, 110, 140), level, dtype=np.float32)


def in_plane(spots: F64, z_mm: float) -> F64:
    """Points (n, 3) of places (n, 2) in voxels of the grid's lateral lattice."""
    lateral = np.asarray(GRID.low_mm)[:2] + np.asarray(GRID.voxel_mm)[:2] * spots
    return np.column_stack([lateral, np.full(len(spots), z_mm)])


def array(wall: Wall | None) -> list[Camera]:
    distorted = [make_camera(x, y, wall) for x, y in ((120.0, -80.0), (-90.0, 130.0))]
    return [*distorted, make_camera(0.0, 10.0, wall, Distortion())]


def smooth_images(seed: int, count: int = 3) -> F32:
    """Noise with details of about three pixels, from 0 to 1. It shows a misplaced sample."""
    noise = np.random.default_rng(seed).standard_normal((count, 110, 140))
    smooth = np.stack([gaussian_filter(image, 1.5, mode="wrap") for image in noise])
    return np.asarray((smooth - smooth.min()) / (smooth.max() - smooth.min()), dtype=np.float32)


def reference(images: F32, rig: list[Camera], grid: Grid) -> F64:
    """Samples (camera, z, y, x) by exact projections; NaN near an image's border."""
    zz, yy, xx = np.meshgrid(*grid.axes_mm[::-1], indexing="ij")
    points = np.stack([xx, yy, zz], axis=-1).reshape(-1, 3)
    samples = np.full((len(rig), len(points)), np.nan)
    for slab in slabs(rig, grid):
        half = (slab.count - 1) / 2.0 * grid.voxel_mm[2]
        planes = np.abs(points[:, 2] - slab.z_mm) <= half + 1e-9
        for number, (image, camera) in enumerate(zip(images, rig, strict=True)):
            samples[number, planes] = looked_up(image, camera, points[planes], grid, slab.z_mm)
    return samples.reshape(len(rig), *grid.shape)


def looked_up(image: F32, camera: Camera, points: F64, grid: Grid, z_mm: float) -> F64:
    pixels = camera.project(points)[0]
    there = np.column_stack([camera.carry(points, z_mm), np.full(len(points), z_mm)])
    voxels = grid.to_voxels(there)[:, :2]
    low = np.floor(voxels.min(axis=0)).astype(int) - 1
    columns, rows = np.ceil(voxels.max(axis=0)).astype(int) + 2 - low
    i, j = np.meshgrid(np.arange(columns) + low[0], np.arange(rows) + low[1])
    corners = np.column_stack([i.ravel(), j.ravel()]) * grid.voxel_mm[:2] + grid.low_mm[:2]
    place = camera.project(np.column_stack([corners, np.full(i.size, z_mm)]))[0][:, ::-1].T
    spline = spline_filter(image.astype(np.float64), mode="mirror")
    plane = map_coordinates(spline, place, mode="mirror", prefilter=False)
    flat = np.maximum(plane, 0.0).reshape(rows, columns)
    value = map_coordinates(flat, (voxels - low)[:, ::-1].T, order=1)
    value[~camera.contains(pixels, -3.5)] = np.nan
    return np.asarray(value)


@pytest.mark.parametrize("wall", [None, TILTED])
def test_refocusing_is_interpolation_at_exact_projections(wall: Wall | None) -> None:
    rig, images = array(wall), smooth_images(5)
    samples = reference(images, rig, GRID)
    seen = np.isfinite(samples).all(axis=0)
    assert 0.05 < seen.mean() < 0.95  # the grid is wider than what the cameras see
    most = np.abs(np.diff(images)).max() * DEVIATION_PX * 3
    found = refocus_sum(images, rig, GRID)
    assert found.dtype == np.float32
    assert_allclose(found[seen], samples.sum(axis=0)[seen], rtol=0, atol=1.5 * most)
    product = np.log2(np.maximum(samples, FLOOR)).sum(axis=0)
    log2 = refocus_log2(images, rig, GRID, FLOOR)
    assert_allclose(np.exp2(log2[seen] / 3), np.exp2(product[seen] / 3), rtol=0, atol=most)
    alone = np.zeros_like(images)
    alone[1] = images[1]
    seen = np.isfinite(samples[1])
    assert_allclose(refocus_sum(alone, rig, GRID)[seen], samples[1][seen], rtol=0, atol=2e-3)


@pytest.mark.slow_but_first
@pytest.mark.parametrize("wall", [None, TILTED])
def test_maps_stay_within_their_tolerance_by_slabs(wall: Wall | None) -> None:
    rig, deep = array(wall), replace(GRID, voxel_mm=(0.06, 0.06, 1.5), shape=(40, 151, 600))
    parts = slabs(rig, deep)
    ends = np.cumsum([0] + [part.count for part in parts])
    assert [part.first for part in parts] == ends[:-1].tolist()
    assert sum(part.count for part in parts) == 40
    assert all(deviation_px(part, rig, deep) <= DEVIATION_PX for part in parts)
    if wall is None:
        assert len(parts) == 1  # scale and shift are exact for a pinhole in air
        assert deviation_px(parts[0], rig, deep) < 1e-3
    else:
        assert deviation_px(make_slab(rig, deep, 0, 40), rig, deep) > DEVIATION_PX


def test_deviation_is_that_of_all_voxels() -> None:
    """The probes find about the largest error of the affine maps, from exact lines of sight."""
    rig = array(TILTED)
    slab = make_slab(rig, GRID, 0, 9)
    maps, worst = slab.tiles(GRID), 0.0
    z, y, x = np.indices((9, 151, 190)).reshape(3, -1)
    tile, row = np.divmod(y, cpu_kernels.TILE_ROWS)
    for number, camera in enumerate(rig):
        q = maps[tile, z, number]
        shift = q[:, [1, 4]] * x[:, None] + q[:, [2, 5]] * row[:, None]
        spots = q[:, [0, 3]] + shift + slab.corners[number]
        points = np.asarray(GRID.low_mm) + np.asarray(GRID.voxel_mm) * np.column_stack([x, y, z])
        exact, there = (camera.project(p)[0] for p in (points, in_plane(spots, slab.z_mm)))
        seen = camera.contains(exact)
        worst = max(worst, float(np.linalg.norm(exact - there, axis=1)[seen].max()))
    assert 0.5 * worst <= deviation_px(slab, rig, GRID) <= 1.001 * worst


@pytest.mark.parametrize("refocused", [refocus_sum, functools.partial(refocus_log2, floor=FLOOR)])
@pytest.mark.parametrize("outside", [0.0, 1.0])
def test_even_images_count_the_cameras(refocused: Callable[..., F32], outside: float) -> None:
    rig = array(FLAT)
    z, y, x = np.meshgrid(*GRID.axes_mm[::-1], indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    pairs = [(camera, camera.project(points)[0]) for camera in rig]
    seen = np.sum([camera.contains(pixel, -0.5) for camera, pixel in pairs], axis=0)
    sure = [camera.contains(p, -2.5) | ~camera.contains(p, 1.5) for camera, p in pairs]
    clear = np.all(sure, axis=0)
    found = refocused(even(0.5, 3), rig, GRID, outside=outside)
    inside, beyond = 0.5, outside
    if refocused is not refocus_sum:
        inside, beyond = -1.0, np.log2(max(outside, FLOOR))
    expected = seen * inside + (3 - seen) * beyond
    assert_allclose(found.ravel()[clear], expected[clear], rtol=0, atol=2e-5)


@pytest.mark.parametrize("shape", [(1, 7, 11), (3, 1, 11), (3, 7, 1), (1, 1, 1)])
def test_grids_of_one_voxel_along_an_axis(shape: tuple[int, int, int]) -> None:
    grid = Grid((0.3, 4.6, 42.0), (0.1, 0.15, 0.4), shape)
    rig, images = array(TILTED), smooth_images(9)
    samples = reference(images, rig, grid).sum(axis=0)
    seen = np.isfinite(samples)
    assert seen.any()
    assert_allclose(refocus_sum(images, rig, grid)[seen], samples[seen], rtol=0, atol=5e-3)


@pytest.mark.parametrize("wall", [None, TILTED])
def test_both_back_ends_agree(wall: Wall | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """But at the borders of images, where a sample is in or out."""
    rig, images = array(wall), smooth_images(10)
    on_cpu = refocus_sum(images, rig, GRID), refocus_log2(images, rig, GRID, FLOOR)
    monkeypatch.setattr(synthetic_aperture, "_on_device", lambda: True)
    elsewhere = refocus_sum(images, rig, GRID), refocus_log2(images, rig, GRID, FLOOR)
    for mine, other in zip(on_cpu, elsewhere, strict=True):
        assert np.quantile(np.abs(mine - other), 0.99) < 0.01
        assert np.median(np.abs(mine - other)) < 5e-4


@pytest.mark.parametrize("level", [0.0, 3.0, 10.0])
def test_many_factors_do_not_leave_the_range_of_floats(level: float) -> None:
    """Thirty cameras whose product is 1e-60, and 1e30 with bright ones."""
    camera = make_camera(0.0, 10.0, None, Distortion())
    grid = Grid((0.5, 4.6, 42.0), (0.05, 0.05, 0.4), (2, 5, 6))
    found = refocus_log2(even(level, 30), [camera] * 30, grid, 0.01)
    assert_allclose(found, 30.0 * np.log2(max(level, 0.01)), rtol=2e-5)


def test_spline_passes_through_pixels_and_is_scipys() -> None:
    images = np.random.default_rng(11).random((2, 37, 53)).astype(np.float32)
    coefficients = coefficients_of(images, CUBIC)
    for image, found in zip(images, coefficients, strict=True):
        expected = spline_filter(image.astype(np.float64), mode="mirror")
        assert_allclose(found[1:-2, 1:-2], expected, rtol=0, atol=3e-6)
    out = np.empty((2, 37, 53), dtype=np.float32)
    identity = np.array([[[26.0, 26.0, 0.0], [18.0, 0.0, 18.0]]] * 2)
    resample(coefficients, CUBIC, identity, 1, 0.0, out)
    assert_allclose(out, images, rtol=0, atol=2e-5)


def test_linear_resampling_is_scipys() -> None:
    images = np.random.default_rng(13).random((1, 37, 53)).astype(np.float32)
    out = np.empty((1, 21, 33), np.float32)
    maps = np.array([[[25.0, 20.0, 3.0], [18.0, 2.0, 14.0]]])
    resample(coefficients_of(images, LINEAR), LINEAR, maps, 1, 0.0, out)
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 33), indexing="ij")
    places = [18.0 + 2.0 * u + 14.0 * v, 25.0 + 20.0 * u + 3.0 * v]
    expected = map_coordinates(images[0].astype(np.float64), places, order=1)
    assert_allclose(out[0], expected, rtol=0, atol=2e-5)


def test_rectifying_maps_are_projections() -> None:
    rig = array(TILTED)
    (slab, *_) = slabs(rig, GRID)
    maps, degree = rectifying_maps(slab, rig, GRID)
    height, width = slab.shape
    unit = np.random.default_rng(12).uniform(-1.0, 1.0, (200, 2))
    powers = [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]
    basis = np.stack([unit[:, 0] ** i * unit[:, 1] ** j for i, j in powers], axis=1)
    for number, camera in enumerate(rig):
        spots = slab.corners[number] + (unit + 1.0) / 2.0 * [width - 1, height - 1]
        points = in_plane(spots, slab.z_mm)
        assert_allclose(basis @ maps[number].T, camera.project(points)[0], rtol=0, atol=1e-3)


def planar_array(wall: Wall | None) -> list[Camera]:
    """Five cameras on one plane, 60 mm apart. They look straight ahead at the grid's middle."""
    plain = make_camera(0.0, 5.0, wall, Distortion())
    places = ((0.0, 5.0), (-60.0, 5.0), (60.0, 5.0), (0.0, -55.0), (0.0, 65.0))
    placed = (replace(plain, center_mm=(x, y, -300.0)) for x, y in places)
    return [aim(camera, (0.7, 5.2, 42.0)) for camera in placed]


@pytest.mark.slow
def test_whole_shifts_find_particles_where_the_exact_maps_do() -> None:
    """Where shifts are whole numbers, up to the published method's bilinear first step."""
    rig, step = planar_array(None), 0.06 * 342.0 / (60.0 + 0.06)  # one voxel between neighbours
    grid = Grid((-1.0, 4.0, 42.0 - step), (0.06, 0.06, step), (3, 41, 57))
    places = np.array([[-0.4, 4.7, 42.0 - step], [0.2, 5.0, 42.0], [1.1, 5.4, 42.0 + step]])
    rows, columns = np.mgrid[0:110, 0:140]
    light = np.zeros((5, 110, 140), dtype=np.float32)
    for image, camera in zip(light, rig, strict=True):
        for column, row in camera.project(places)[0]:
            image += np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 4.0)
    shifted, exact = refocus_by_shifts(light, rig, grid), refocus_sum(light, rig, grid) / 5.0
    assert np.abs(shifted - exact).max() < 0.12
    for plane, place in enumerate(places):
        x, y, _ = np.rint(grid.to_voxels(place[None])[0]).astype(int)
        assert shifted[plane].max() > 0.85
        peak = np.unravel_index(shifted[plane].argmax(), shifted[plane].shape)
        assert np.abs(np.asarray(peak) - [y, x]).max() <= 1


@pytest.mark.slow
def test_whole_shifts_keep_an_even_image_even() -> None:
    grid = Grid((0.2, 4.9, 41.0), (0.06, 0.06, 0.5), (4, 9, 11))
    assert_allclose(refocus_by_shifts(even(0.75, 5), planar_array(FLAT), grid), 0.75, rtol=1e-5)
