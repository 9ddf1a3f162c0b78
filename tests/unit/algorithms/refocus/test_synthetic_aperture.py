"""Refocusing against a second implementation, and between both back ends. The second implementation
uses exact projection, and scipy's splines and interpolation."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

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
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.utils.arrays import F32, F64

FLOOR = 0.05
FLAT = Wall((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0, (Layer("glass", 1.52, 5.0),), 1.333)
TILTED = replace(FLAT, normal=(0.28, 0.0, 0.96))
BROWN = Distortion(-0.4, 2.0, 2e-3, -3e-3, 0.0)
GRID = Grid((-5.0, 0.7, 40.0), (0.06, 0.06, 0.5), (9, 151, 190))


def make_camera(x: float, y: float, wall: Wall | None, lens: Distortion = BROWN) -> Camera:
    camera = Camera(
        name="camera_00",
        rows=110,
        columns=140,
        center_mm=(x, y, -300.0),
        rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),
        principal_distance_mm=60.0,
        pixel_mm=0.01,
        principal_point_px=(66.0, 47.0),
        distortion=lens,
        focal_length_mm=45.0,
        f_number=8.0,
        wall=wall,
    )
    return aim(camera, (1.0, 5.0, 42.0))


def array(wall: Wall | None) -> list[Camera]:
    return [
        make_camera(120.0, -80.0, wall),
        make_camera(-90.0, 130.0, wall),
        make_camera(0.0, 10.0, wall, Distortion()),
    ]


def smooth_images(seed: int, count: int = 3) -> F32:
    """Noise with details of about three pixels, from 0 to 1. It shows a misplaced sample."""
    noise = np.random.default_rng(seed).standard_normal((count, 110, 140))
    smooth = np.stack([gaussian_filter(image, 1.5, mode="wrap") for image in noise])
    return np.asarray((smooth - smooth.min()) / (smooth.max() - smooth.min()), dtype=np.float32)


def reference(images: F32, cameras: list[Camera], grid: Grid) -> F64:
    """Return samples (camera, z, y, x) by exact projections. A spline onto the slab's plane, then
    bilinear interpolation. NaN near an image's border."""
    x, y, z = grid.axes_mm
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    points = np.stack([xx, yy, zz], axis=-1).reshape(-1, 3)
    samples = np.full((len(cameras), len(points)), np.nan)
    for slab in slabs(cameras, grid):
        planes = (
            np.abs(points[:, 2] - slab.z_mm) <= (slab.count - 1) / 2.0 * grid.voxel_mm[2] + 1e-9
        )
        for number, (image, camera) in enumerate(zip(images, cameras, strict=True)):
            samples[number, planes] = looked_up(image, camera, points[planes], grid, slab.z_mm)
    return samples.reshape(len(cameras), *grid.shape)


def looked_up(image: F32, camera: Camera, points: F64, grid: Grid, z_mm: float) -> F64:
    pixels = camera.project(points)[0]
    rays = camera.back_project(pixels)
    hits = (
        rays.origins_mm + (z_mm - rays.origins_mm[:, 2:]) / rays.directions[:, 2:] * rays.directions
    )
    voxels = grid.to_voxels(hits)[:, :2]
    low = np.floor(voxels.min(axis=0)).astype(int) - 1
    columns, rows = np.ceil(voxels.max(axis=0)).astype(int) + 2 - low
    i, j = np.meshgrid(np.arange(columns) + low[0], np.arange(rows) + low[1])
    corners = (
        np.column_stack([i.ravel(), j.ravel()]) * np.asarray(grid.voxel_mm)[:2]
        + np.asarray(grid.low_mm)[:2]
    )
    place = camera.project(np.column_stack([corners, np.full(i.size, z_mm)]))[0]
    spline = map_coordinates(
        spline_filter(image.astype(np.float64), mode="mirror"),
        place[:, ::-1].T,
        mode="mirror",
        prefilter=False,
    )
    flat = np.maximum(spline, 0.0).reshape(rows, columns)
    value = map_coordinates(flat, (voxels - low)[:, ::-1].T, order=1)
    value[~camera.contains(pixels, -3.5)] = np.nan
    return np.asarray(value)


@pytest.mark.parametrize("wall", [None, FLAT, TILTED])
def test_refocusing_is_interpolation_at_exact_projections(wall: Wall | None) -> None:
    cameras, images = array(wall), smooth_images(5)
    samples = reference(images, cameras, GRID)
    seen = np.isfinite(samples).all(axis=0)
    assert 0.05 < seen.mean() < 0.95  # the grid is wider than what the cameras see
    steepest = np.abs(np.diff(images)).max()
    found = refocus_sum(images, cameras, GRID)
    assert found.dtype == np.float32
    assert_allclose(
        found[seen], samples.sum(axis=0)[seen], rtol=0, atol=3 * steepest * DEVIATION_PX * 1.5
    )
    product = np.log2(np.maximum(samples, FLOOR)).sum(axis=0)
    log2 = refocus_log2(images, cameras, GRID, FLOOR)
    assert_allclose(
        np.exp2(log2[seen] / 3),
        np.exp2(product[seen] / 3),
        rtol=0,
        atol=steepest * DEVIATION_PX * 3,
    )


@pytest.mark.parametrize("wall", [None, FLAT, TILTED])
def test_maps_stay_within_their_tolerance_by_slabs(wall: Wall | None) -> None:
    cameras, deep = array(wall), replace(GRID, voxel_mm=(0.06, 0.06, 1.5), shape=(40, 151, 600))
    parts = slabs(cameras, deep)
    assert [part.first for part in parts] == list(
        np.cumsum([0] + [part.count for part in parts])[:-1]
    )
    assert sum(part.count for part in parts) == 40
    assert all(deviation_px(part, cameras, deep) <= DEVIATION_PX for part in parts)
    if wall is None:
        assert len(parts) == 1  # scale and shift are exact for a pinhole in air
        assert deviation_px(parts[0], cameras, deep) < 1e-3
    else:
        assert deviation_px(make_slab(cameras, deep, 0, 40), cameras, deep) > DEVIATION_PX


def test_deviation_is_that_of_all_voxels() -> None:
    """The probes find about the largest error of the affine maps. It is their distance from exact
    lines of sight."""
    cameras = array(TILTED)
    slab = make_slab(cameras, GRID, 0, 9)
    maps, worst = slab.tiles(GRID), 0.0
    z, y, x = (
        v.ravel() for v in np.meshgrid(np.arange(9), np.arange(151), np.arange(190), indexing="ij")
    )
    tile = y // cpu_kernels.TILE_ROWS
    for number, camera in enumerate(cameras):
        q = maps[tile, z, number]
        row = y % cpu_kernels.TILE_ROWS
        spot = (
            q[:, [0, 3]]
            + q[:, [1, 4]] * x[:, None]
            + q[:, [2, 5]] * row[:, None]
            + slab.corners[number]
        )
        step, low = np.asarray(GRID.voxel_mm), np.asarray(GRID.low_mm)
        exact = camera.project(low + step * np.column_stack([x, y, z]))[0]
        there = camera.project(
            np.column_stack([low[:2] + step[:2] * spot, np.full(len(x), slab.z_mm)])
        )[0]
        seen = camera.contains(exact)
        worst = max(worst, float(np.linalg.norm(exact - there, axis=1)[seen].max()))
    assert 0.5 * worst <= deviation_px(slab, cameras, GRID) <= 1.001 * worst


def test_refocusing_samples_each_camera_by_itself() -> None:
    cameras, images = array(TILTED), smooth_images(6)
    samples = reference(images, cameras, GRID)
    for number in range(3):
        alone = np.zeros_like(images)
        alone[number] = images[number]
        seen = np.isfinite(samples[number])
        assert_allclose(
            refocus_sum(alone, cameras, GRID)[seen], samples[number][seen], rtol=0, atol=2e-3
        )


def test_sum_is_linear() -> None:
    cameras, first, second = (
        array(FLAT),
        smooth_images(7) + np.float32(0.5),
        smooth_images(8) + np.float32(0.5),
    )  # no spline dips below zero
    both = refocus_sum(2.0 * first + np.float32(0.5) * second, cameras, GRID)
    apart = 2.0 * refocus_sum(first, cameras, GRID) + 0.5 * refocus_sum(second, cameras, GRID)
    assert_allclose(both, apart, rtol=0, atol=1e-5)


@pytest.mark.parametrize("refocused", [refocus_sum, functools.partial(refocus_log2, floor=FLOOR)])
@pytest.mark.parametrize("outside", [0.0, 1.0])
def test_even_images_show_how_many_cameras_see_a_voxel(
    refocused: Callable[..., F32], outside: float
) -> None:
    cameras = array(FLAT)
    x, y, z = np.meshgrid(*GRID.axes_mm, indexing="ij")
    points = np.stack([x, y, z], axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    pixels = [camera.project(points)[0] for camera in cameras]
    seen = np.sum(
        [camera.contains(pixel, -0.5) for camera, pixel in zip(cameras, pixels, strict=True)],
        axis=0,
    ).reshape(GRID.shape)
    clear = np.all(
        [
            camera.contains(p, -2.5) | ~camera.contains(p, 1.5)
            for camera, p in zip(cameras, pixels, strict=True)
        ],
        axis=0,
    )
    found = refocused(np.full((3, 110, 140), 0.5, dtype=np.float32), cameras, GRID, outside=outside)
    inside, beyond = (
        (0.5, outside) if refocused is refocus_sum else (-1.0, np.log2(max(outside, FLOOR)))
    )
    expected = seen * inside + (3 - seen) * beyond
    assert_allclose(found.ravel()[clear], expected.ravel()[clear], rtol=0, atol=2e-5)


@pytest.mark.parametrize("shape", [(1, 7, 11), (3, 1, 11), (3, 7, 1), (1, 1, 1)])
def test_grids_of_one_voxel_along_an_axis(shape: tuple[int, int, int]) -> None:
    grid, cameras, images = (
        Grid((0.3, 4.6, 42.0), (0.1, 0.15, 0.4), shape),
        array(TILTED),
        smooth_images(9),
    )
    samples = reference(images, cameras, grid)
    seen = np.isfinite(samples).all(axis=0)
    assert seen.any()
    assert_allclose(
        refocus_sum(images, cameras, grid)[seen], samples.sum(axis=0)[seen], rtol=0, atol=5e-3
    )


@pytest.mark.parametrize("wall", [None, TILTED])
def test_both_back_ends_make_the_same_volume(
    wall: Wall | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras, images = array(wall), smooth_images(10)
    on_cpu = refocus_sum(images, cameras, GRID), refocus_log2(images, cameras, GRID, FLOOR)
    monkeypatch.setattr(synthetic_aperture, "_on_device", lambda: True)
    elsewhere = refocus_sum(images, cameras, GRID), refocus_log2(images, cameras, GRID, FLOOR)
    for mine, other in zip(on_cpu, elsewhere, strict=True):
        assert (
            np.quantile(np.abs(mine - other), 0.99) < 0.01
        )  # the rest lies at the borders of images, where a sample is in or out
        assert np.median(np.abs(mine - other)) < 5e-4


def test_many_factors_do_not_leave_the_range_of_floats() -> None:
    """Thirty cameras whose product is 1e-60, and 1e30 with bright ones."""
    camera = make_camera(0.0, 10.0, None, Distortion())
    grid = Grid((0.5, 4.6, 42.0), (0.05, 0.05, 0.4), (2, 5, 6))
    for level in (0.0, 0.01, 3.0, 10.0):
        found = refocus_log2(
            np.full((30, 110, 140), level, dtype=np.float32), [camera] * 30, grid, 0.01
        )
        assert_allclose(found, 30.0 * np.log2(max(level, 0.01)), rtol=2e-5)


def test_a_particle_in_all_images_is_brightest_where_it_is() -> None:
    cameras, voxel = array(TILTED), (4, 71, 101)
    x, y, z = GRID.axes_mm
    place = np.array([[x[voxel[2]], y[voxel[1]], z[voxel[0]]]])
    rows, columns = np.mgrid[0:110, 0:140]
    pixels = [camera.project(place)[0][0] for camera in cameras]
    images = np.stack(
        [np.exp(-((columns - c) ** 2 + (rows - r) ** 2) / 4.0) for c, r in pixels]
    ).astype(np.float32)
    assert refocus_log2(images, cameras, GRID, FLOOR).argmax() == np.ravel_multi_index(
        voxel, GRID.shape
    )


def test_spline_passes_through_pixels_and_is_scipys() -> None:
    images = np.random.default_rng(11).random((2, 37, 53)).astype(np.float32)
    coefficients = coefficients_of(images, CUBIC)
    for image, found in zip(images, coefficients, strict=True):
        assert_allclose(
            found[1:-2, 1:-2],
            spline_filter(image.astype(np.float64), mode="mirror"),
            rtol=0,
            atol=3e-6,
        )
    out = np.empty((2, 37, 53), dtype=np.float32)
    identity = np.array([[[26.0, 26.0, 0.0], [18.0, 0.0, 18.0]]] * 2)
    resample(coefficients, CUBIC, identity, 1, 0.0, out)
    assert_allclose(out, images, rtol=0, atol=2e-5)


def test_linear_resampling_is_scipys() -> None:
    images = np.random.default_rng(13).random((1, 37, 53)).astype(np.float32)
    out = np.empty((1, 21, 33), dtype=np.float32)
    resample(
        coefficients_of(images, LINEAR),
        LINEAR,
        np.array([[[25.0, 20.0, 3.0], [18.0, 2.0, 14.0]]]),
        1,
        0.0,
        out,
    )
    v, u = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 33), indexing="ij")
    expected = map_coordinates(
        images[0].astype(np.float64),
        [18.0 + 2.0 * u + 14.0 * v, 25.0 + 20.0 * u + 3.0 * v],
        order=1,
    )
    assert_allclose(out[0], expected, rtol=0, atol=2e-5)


def test_rectifying_maps_are_projections() -> None:
    cameras = array(TILTED)
    (slab, *_) = slabs(cameras, GRID)
    maps, degree = rectifying_maps(slab, cameras, GRID)
    height, width = slab.shape
    unit = np.random.default_rng(12).uniform(-1.0, 1.0, (200, 2))
    powers = [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]
    basis = np.stack([unit[:, 0] ** i * unit[:, 1] ** j for i, j in powers], axis=1)
    for number, camera in enumerate(cameras):
        spot = slab.corners[number] + (unit + 1.0) / 2.0 * [width - 1, height - 1]
        points = np.column_stack(
            [
                np.asarray(GRID.low_mm)[:2] + np.asarray(GRID.voxel_mm)[:2] * spot,
                np.full(200, slab.z_mm),
            ]
        )
        assert_allclose(basis @ maps[number].T, camera.project(points)[0], rtol=0, atol=1e-3)


def planar_array(wall: Wall | None) -> list[Camera]:
    """Five cameras on one plane, 60 mm apart. They look straight ahead at the grid's middle."""
    places = ((0.0, 0.0), (-60.0, 0.0), (60.0, 0.0), (0.0, -60.0), (0.0, 60.0))
    return [
        aim(
            replace(make_camera(0.0, 5.0, wall, Distortion()), center_mm=(x, y + 5.0, -300.0)),
            (0.7, 5.2, 42.0),
        )
        for x, y in places
    ]


@pytest.mark.slow
def test_whole_shifts_find_particles_where_the_exact_maps_do() -> None:
    """The published method equals exact refocusing where shifts are whole numbers. On such planes,
    both agree up to the method's bilinear first step."""
    cameras = planar_array(None)
    distance = 342.0
    step = (
        0.06 * distance / (60.0 + 0.06)
    )  # one voxel of shift between neighbours, at the middle plane
    grid = Grid((-1.0, 4.0, 42.0 - step), (0.06, 0.06, step), (3, 41, 57))
    images = np.zeros((5, 110, 140), dtype=np.float32)
    places = np.array([[0.2, 5.0, 42.0 + k * step] for k in (-1, 0, 1)]) + np.array(
        [[-0.6, -0.3, 0.0], [0.0, 0.0, 0.0], [0.9, 0.4, 0.0]]
    )
    rows, columns = np.mgrid[0:110, 0:140]
    for image, camera in zip(images, cameras, strict=True):
        for column, row in camera.project(places)[0]:
            image += np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 4.0)
    shifted, exact = (
        refocus_by_shifts(images, cameras, grid),
        refocus_sum(images, cameras, grid) / 5.0,
    )
    assert np.abs(shifted - exact).max() < 0.12
    for plane, place in enumerate(places):
        x, y, _ = np.rint(grid.to_voxels(place[None])[0]).astype(int)
        assert shifted[plane].max() > 0.85
        peak = np.unravel_index(shifted[plane].argmax(), shifted[plane].shape)
        assert np.abs(np.asarray(peak) - [y, x]).max() <= 1


def test_whole_shifts_keep_an_even_image_even() -> None:
    cameras = planar_array(FLAT)
    grid = Grid((0.2, 4.9, 41.0), (0.06, 0.06, 0.5), (4, 9, 11))
    assert_allclose(
        refocus_by_shifts(np.full((5, 110, 140), 0.75, dtype=np.float32), cameras, grid),
        0.75,
        rtol=1e-5,
    )
