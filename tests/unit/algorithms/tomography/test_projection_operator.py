"""The operator W against dense matrices from exact projections."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import erf

from sabench.algorithms.tomography import supersampling
from sabench.algorithms.tomography.problem import (
    TomographyParameters,
    TomographyProblem,
    every_voxel,
    product_guess,
)
from sabench.algorithms.tomography.projection_operator import (
    BILINEAR,
    Footprint,
    ProjectionOperator,
    Support,
    gaussian,
    image_sigma_px,
    make_geometry,
)
from sabench.api import Observation
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Wall
from sabench.utils.arrays import F32, F64, triple
from tests.unit.algorithms.refocus import test_synthetic_aperture
from tests.unit.algorithms.refocus.test_synthetic_aperture import TILTED

GRID = Grid((-0.5, 0.7, 40.0), (0.05, 0.045, 0.06), (5, 12, 19))
BLOB = gaussian(0.6)
ROWS, COLUMNS = 36, 44


def make_camera(
    x: float, y: float, wall: Wall | None, shift_px: tuple[float, float] = (0.0, 0.0)
) -> Camera:
    middle, lens = ((COLUMNS - 1) / 2.0, (ROWS - 1) / 2.0), Distortion(-0.4, 2.0)
    own: dict[str, Any] = {"rows": ROWS, "columns": COLUMNS, "principal_point_px": middle}
    own |= {"principal_distance_mm": 68.0, "at": [axis.mean() for axis in GRID.axes_mm]}
    aimed = test_synthetic_aperture.make_camera(x, y, wall, lens, **own)
    return replace(aimed, principal_point_px=triple([*np.add(middle, shift_px), 0.0])[:2])


def random_light(rng: np.random.Generator, lines: ProjectionOperator) -> tuple[F32, F32]:
    """Values of voxels, and images."""
    values = rng.random(len(lines.support), dtype=np.float32)
    return values, rng.random((3, ROWS, COLUMNS), dtype=np.float32)


def array(wall: Wall | None) -> list[Camera]:
    """Cameras of which only the first sees the whole grid."""
    return [
        make_camera(120.0, -80.0, wall),
        make_camera(-90.0, 130.0, wall, (-14.4, -11.5)),
        make_camera(0.0, 10.0, wall, (18.4, 13.7)),
    ]


def lines_of(
    rig: list[Camera], footprint: Footprint, grid: Grid = GRID, every: int = 1
) -> ProjectionOperator:
    """W on all voxels, or on every so many of them."""
    geometry = make_geometry(rig, grid, footprint.margin)
    support, _ = every_voxel(geometry)
    keep = np.arange(len(support)) % every == 0
    rows = np.repeat(np.arange(len(support.start) - 1), np.diff(support.start))[keep]
    start = np.searchsorted(rows, np.arange(len(support.start)))
    return ProjectionOperator(geometry, Support(support.shape, start, support.x[keep]), footprint)


def positions(camera: Camera, grid: Grid = GRID) -> F64:
    """Exact pixels (n, 2) of all voxels in the order of a support."""
    z, y, x = np.meshgrid(*grid.axes_mm[::-1], indexing="ij")
    return camera.project(np.column_stack([x.ravel(), y.ravel(), z.ravel()]))[0]


def dense(camera: Camera, footprint: Footprint, grid: Grid = GRID) -> F64:
    """W (pixel, voxel) of one camera by exact projections."""
    matrix = np.zeros((ROWS, COLUMNS, grid.shape[0] * grid.shape[1] * grid.shape[2]))
    for voxel, (column, row) in enumerate(positions(camera, grid)):
        left, top, m = int(np.floor(column)), int(np.floor(row)), footprint.margin
        if m <= left < COLUMNS - 1 - m and m <= top < ROWS - 1 - m:
            pair = [np.array([1.0 - share, share]) for share in (row - top, column - left)]
            down, across = (
                np.convolve(p, [footprint.spread, 1.0 - 2.0 * footprint.spread, footprint.spread])
                for p in pair
            )
            patch = np.outer(down, across)[1 - m : 3 + m, 1 - m : 3 + m]
            matrix[top - m : top + 2 + m, left - m : left + 2 + m, voxel] = patch
    return matrix.reshape(ROWS * COLUMNS, -1)


@pytest.mark.parametrize("footprint", [BILINEAR, BLOB])
@pytest.mark.parametrize("wall", [None, TILTED])
def test_forward_and_adjoint_are_exact_projections(wall: Wall | None, footprint: Footprint) -> None:
    """A voxel is within 1 / 2048 of its place, its map within 1e-3."""
    rig = array(wall)
    lines = lines_of(rig, footprint)
    values, images = random_light(np.random.default_rng(1), lines)
    matrices = [dense(camera, footprint) for camera in rig]
    seen = np.sum([matrix.sum(axis=0) for matrix in matrices], axis=0)
    assert set(np.rint(seen)) >= {1.0, 2.0}  # some voxels are beyond the border of a camera or two
    for number, (image, matrix) in enumerate(zip(lines.forward(values), matrices, strict=True)):
        assert_allclose(image.ravel(), matrix @ values, rtol=0, atol=4e-3)
        assert_allclose(lines.forward(values, [number])[0], image, rtol=0, atol=1e-6)
    parts = [matrix.T @ image.ravel() for image, matrix in zip(images, matrices, strict=True)]
    assert_allclose(lines.adjoint(images), sum(parts), rtol=0, atol=4e-3)
    assert_allclose(lines.adjoint(images[2:], [2]), parts[2], rtol=0, atol=2e-3)
    assert_allclose(lines.adjoint(np.ones_like(images)), seen, rtol=0, atol=1e-5)


@pytest.mark.parametrize("footprint", [BILINEAR, BLOB])
@pytest.mark.parametrize("wall", [None, TILTED])
def test_adjoint_passes_the_dot_test(wall: Wall | None, footprint: Footprint) -> None:
    lines = lines_of(array(wall), footprint, every=3)
    values, images = random_light(np.random.default_rng(2), lines)
    forward = np.vdot(lines.forward(values).astype(np.float64), images)
    back = np.vdot(values.astype(np.float64), lines.adjoint(images))
    assert forward == pytest.approx(back, rel=1e-6)


def test_parts_hold_every_voxel_once() -> None:
    support = Support((2, 3, 4), np.array([0, 4, 4, 5, 9, 9, 10]), np.zeros(10, dtype=np.int16))
    for count in (1, 2, 3, 20):
        parts = support.parts(count)
        assert (parts[0], parts[-1], len(parts)) == (0, 6, count + 1)
        assert (np.diff(parts) >= 0).all()
    none = Support((1, 2, 3), np.zeros(3, dtype=np.int64), np.zeros(0, dtype=np.int16))
    assert_array_equal(none.parts(4)[[0, -1]], [0, 2])


@pytest.mark.parametrize("wall", [None, TILTED])
@pytest.mark.parametrize("nearest", [False, True])
def test_first_guess_is_the_root_of_the_product(wall: Wall | None, nearest: bool) -> None:
    rig, threshold = array(wall), 0.45
    images = np.random.default_rng(4).random((3, ROWS, COLUMNS), dtype=np.float32) + np.float32(0.1)
    geometry = make_geometry(rig, GRID, 0)
    geometry = geometry._replace(shift=0.5, mask=0) if nearest else geometry
    support, values = product_guess(geometry, images, threshold)
    rows = np.repeat(np.arange(len(support.start) - 1), np.diff(support.start))
    found = np.zeros(np.prod(GRID.shape))
    found[rows * GRID.shape[2] + support.x] = values
    pairs = [sampled(camera, image, nearest) for camera, image in zip(rig, images, strict=True)]
    sample, sure = np.stack([one for one, _ in pairs]), [safe for _, safe in pairs]
    lit = np.nan_to_num(sample, nan=1.0).min(axis=0)
    clear = np.all(sure, axis=0) & (np.abs(lit - threshold) > 3e-3)
    counts = np.maximum(np.isfinite(sample).sum(axis=0), 1)
    expected = np.where(lit > threshold, np.nanprod(sample, axis=0) ** (1.0 / counts), 0.0)
    assert 0.1 < (expected > 0.0).mean() < 0.9
    assert clear.mean() > 0.85
    assert_allclose(found[clear], expected[clear], rtol=0, atol=6e-3)


def sampled(camera: Camera, image: F32, nearest: bool) -> tuple[F64, Any]:
    """Samples at all voxels, NaN where not seen, and which are safe from rounding."""
    if not nearest:
        matrix = dense(camera, BILINEAR)
        seen = matrix.sum(axis=0) > 0.5
        return np.where(seen, matrix.T @ image.ravel(), np.nan), np.ones(len(seen), dtype=bool)
    pixel = positions(camera) + 0.5
    column, row = np.floor(pixel).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < COLUMNS - 1) & (row < ROWS - 1)
    value = np.full(len(pixel), np.nan)
    value[inside] = image[row[inside], column[inside]]
    return value, (np.abs(pixel - np.rint(pixel)) > 2e-3).all(axis=1)


def test_voxels_that_no_camera_sees_are_left_out() -> None:
    camera = make_camera(0.0, 0.0, None, (23.2, 0.0))
    white = np.ones((1, ROWS, COLUMNS), dtype=np.float32)
    support, values = product_guess(make_geometry([camera], GRID, 1), white, 0.5)
    assert len(support) == len(values) == int((dense(camera, BLOB).sum(axis=0) > 0.5).sum())
    assert 0 < len(support) < np.prod(GRID.shape)


def test_a_uniform_guess_is_as_bright_as_the_images_and_dark_where_no_camera_looks() -> None:
    camera = make_camera(0.0, 0.0, None, (23.2, 0.0))
    images = np.random.default_rng(6).integers(100, 200, (1, ROWS, COLUMNS), dtype=np.uint16)
    case = Observation(images, (camera,), GRID, 50.0, 255.0)
    problem = TomographyProblem.from_case(case, TomographyParameters(sigma_px=0.6))
    state = problem.uniform()
    seen = dense(camera, BLOB).sum(axis=0) > 0.5
    assert_array_equal(state.values > 0.0, seen)
    light = problem.measured.light.sum()
    assert state.lines.forward(state.values).sum() == pytest.approx(light, rel=1e-4)
    assert np.ptp(state.values[seen]) == 0.0


@pytest.mark.parametrize("sigma", [0.3, 0.6, 0.8])
def test_a_blob_casts_about_a_gaussian(sigma: float) -> None:
    """It keeps its light and position, and over a pixel the variance of an integrated Gaussian."""
    right = (np.arange(64) + 0.5) / 64
    image = np.zeros((64, 5, 9), dtype=np.float32)
    image[:, 2, 3], image[:, 2, 4] = 1.0 - right, right
    cast = gaussian(sigma).smooth(image).astype(np.float64)
    assert gaussian(sigma).margin == 1
    assert_allclose(cast.sum(axis=(1, 2)), 1.0, atol=1e-6)
    away = np.arange(9)[None] - (3.0 + right)[:, None]
    line = cast.sum(axis=1)
    assert_allclose((line * away).sum(axis=1), 0.0, atol=1e-6)
    assert (line * away**2).sum(axis=1).mean() == pytest.approx(sigma**2 + 1.0 / 12.0, rel=1e-3)


@pytest.mark.parametrize("sigma", [0.5, 0.85])
def test_image_size_is_measured_in_a_crowd(sigma: float) -> None:
    rng, edges = np.random.default_rng(5), np.arange(121) - 0.5
    image = np.zeros((120, 120))
    for x, y in rng.uniform(2.0, 117.0, (700, 2)):  # 0.05 per pixel
        across, down = (np.diff(erf((edges - c) / (sigma * np.sqrt(2.0)))) for c in (x, y))
        image += np.outer(down, across)
    image /= np.quantile(image[image > 0.1 * image.max()], 0.95)
    found = image_sigma_px(image[None].astype(np.float32))
    assert found == pytest.approx(np.sqrt(sigma**2 + 1.0 / 12.0), rel=0.05)
    assert image_sigma_px(np.zeros((1, 20, 20), dtype=np.float32)) is None


def test_long_voxels_are_split_and_short_ones_are_not() -> None:
    rig = [make_camera(240.0, 0.0, None), make_camera(0.0, 0.0, None)]
    scale = supersampling.scale_of(rig, replace(GRID, voxel_mm=(0.05, 0.05, 0.2)))
    far = np.hypot(340.0, 240.0)
    assert scale.px_per_mm == pytest.approx(np.mean([6800.0 / far, 6800.0 / 340.0]), rel=0.02)
    assert scale.travel_px[0] == pytest.approx(1.0, rel=0.02)
    assert scale.travel_px[2] == pytest.approx(6800.0 * 0.2 * 240.0 / far**2, rel=0.02)
    assert supersampling.splits(scale) == (1, 1, 2)
    fine = supersampling.split(Grid((0.0, 1.0, 2.0), (0.1, 0.2, 0.3), (2, 3, 4)), (1, 2, 3))
    assert fine.shape == (6, 6, 4)
    assert_allclose(fine.low_mm, (0.0, 0.95, 1.9))
    assert_allclose(fine.voxel_mm, (0.1, 0.1, 0.1))


@pytest.mark.parametrize(
    ("count", "sigma"), [((1, 1, 1), 0.06), ((2, 1, 3), 0.05), ((2, 1, 3), 0.0)]
)
def test_volume_is_the_sum_of_blobs(count: tuple[int, int, int], sigma: float) -> None:
    grid = Grid((0.0, 0.0, 0.0), (0.05, 0.05, 0.1), (6, 9, 11))
    fine = supersampling.split(grid, count)
    x, y, z = 6 * count[0] - 1, 5 * count[1] - 1, 4 * count[2] - 1
    start = np.zeros(fine.shape[0] * fine.shape[1] + 1, dtype=np.int64)
    start[z * fine.shape[1] + y + 1 :] = 1
    support = Support(fine.shape, start, np.array([x], dtype=np.int16))
    volume = supersampling.gather(support, np.array([2.0], np.float32), grid, count, sigma)
    centre = [float(axis[i]) for axis, i in zip(fine.axes_mm, (x, y, z), strict=True)]
    shares = [
        share_of(axis, step, c, sigma)
        for axis, step, c in zip(grid.axes_mm, grid.voxel_mm, centre, strict=True)
    ]
    assert_allclose(volume, 2.0 * np.einsum("k,j,i->kji", *shares[::-1]), rtol=0, atol=0.02)
    assert volume.sum() == pytest.approx(2.0, rel=1e-5)


def share_of(axis: F64, step: float, centre: float, sigma: float) -> F64:
    """The part of a Gaussian's light in each voxel along one axis."""
    edges = np.append(axis - step / 2.0, axis[-1] + step / 2.0)
    if not sigma:
        return np.diff((edges > centre).astype(np.float64))
    return np.diff(erf((edges - centre) / (sigma * np.sqrt(2.0))) / 2.0)


def test_dim_voxels_become_zero() -> None:
    volume = np.linspace(0.0, 1.0, 101, dtype=np.float32).reshape(1, 1, 101)
    bright = np.percentile(volume[volume > 0.1], 95.0)
    assert_array_equal(supersampling.clear_dark(volume.copy(), 0.25) > 0.0, volume >= 0.25 * bright)
    assert_array_equal(supersampling.clear_dark(volume.copy(), 0.0), volume)
    assert not supersampling.clear_dark(np.full((2, 3, 4), 1e-4, dtype=np.float32), 0.25).any()
