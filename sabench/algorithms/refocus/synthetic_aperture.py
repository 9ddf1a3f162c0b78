"""Synthetic aperture refocusing: views of all cameras, added or multiplied.

A voxel x becomes the product over the cameras i of max(floor, I_i(project_i(x))) to the power n, or
their mean. This module returns sums of samples or of their logarithms; solvers do the rest.
All else makes this fast, to 0.01 px: `slabs` fits the projection of some planes by polynomials,
`rectification` warps each image once so that a plane is a constant shift, and `cpu_kernels` add or
multiply shifted rows. On a GPU each sample is a gather by Dr.Jit, from the same slabs and rectified
images, so that the volumes are the same.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.refocus import cpu_kernels
from sabench.algorithms.refocus.cpu_kernels import TILE_COLUMNS, TILE_ROWS
from sabench.algorithms.refocus.rectification import CUBIC, LINEAR, coefficients_of, resample
from sabench.algorithms.refocus.slabs import Slab, make_slab, rectifying_maps, slabs, tile_origins
from sabench.api import Observation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import AT_ONCE, Grid
from sabench.utils import backend
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores

# (drjit, one array of samples per camera) -> the plane's voxels
Fold = Callable[[Any, Sequence[Any]], Any]


def _sum_planes_on_device(rectified: F32, slab: Slab, grid: Grid, outside: float, out: F32) -> None:
    """Sum images as `cpu_kernels.sum_planes`, by exact maps."""
    _sweep(rectified, slab, grid, outside, lambda dr, samples: sum(samples), out)


def _multiply_planes_on_device(
    rectified: F32, slab: Slab, grid: Grid, outside: float, floor: float, out: F32
) -> None:
    """Multiply images as `cpu_kernels.multiply_planes`, with exact maps."""

    def fold(dr: Any, samples: Sequence[Any]) -> Any:
        return sum(dr.log2(dr.maximum(sample, floor)) for sample in samples)

    _sweep(rectified, slab, grid, outside, fold, out)


def _sweep(rectified: F32, slab: Slab, grid: Grid, outside: float, fold: Fold, out: F32) -> None:
    dr, types = backend.drjit()
    flat = [types.Float(image.ravel()) for image in rectified]
    maps = np.ascontiguousarray(slab.positions(grid), dtype=np.float32)
    table = types.Float(maps.ravel())  # (camera, plane, column or row, term)
    height, width = out.shape[1:]
    some = max(1, AT_ONCE // (height * width))
    for first in range(0, len(out), some):
        part = out[first : first + some]
        index = dr.arange(types.UInt32, part.size)
        line = index // width
        plane = line // height
        u = _unit(types.Float(index - line * width), width)
        v = _unit(types.Float(line - plane * height), height)
        plane += dr.opaque(types.UInt32, first)
        samples = []
        for camera, image in enumerate(flat):
            start = (plane + camera * len(out)) * (2 * maps.shape[-1])
            position = [
                _polynomial(dr, types, table, start + axis * maps.shape[-1], slab.degree, u, v)
                for axis in (0, 1)
            ]
            samples.append(_sample(dr, types, image, slab.shape, position, outside))
        folded = np.asarray(fold(dr, samples))
        lines = part.reshape(-1, width)
        on_cores(_keep, len(lines), folded.reshape(-1, width), lines)


@numba.njit(cache=True, nogil=True)
def _keep(jobs: slice, values: Any, out: Any) -> None:  # pragma: no cover
    """Copy rows with all cores: one core takes longer for a volume than the device."""
    for row in range(jobs.start, jobs.stop):
        for column in range(out.shape[1]):
            out[row, column] = values[row, column]


def _unit(index: Any, count: int) -> Any:
    return index * (2.0 / max(count - 1, 1)) - (1.0 if count > 1 else 0.0)


def _sample(
    dr: Any, types: Any, image: Any, shape: tuple[int, int], position: Sequence[Any], outside: float
) -> Any:
    """Sample an image bilinearly at (column, row); `outside` beyond its centres."""
    rows, columns = shape
    column, row = position
    inside = (column >= 0.0) & (row >= 0.0) & (column <= columns - 1.0) & (row <= rows - 1.0)
    left = dr.minimum(types.Int32(dr.floor(column)), columns - 2)
    top = dr.minimum(types.Int32(dr.floor(row)), rows - 2)
    right_share, bottom_share = column - types.Float(left), row - types.Float(top)
    corner = types.UInt32(top * columns + left)
    values = [
        dr.gather(types.Float, image, corner + offset, inside)
        for offset in (0, 1, columns, columns + 1)
    ]
    upper = dr.fma(right_share, values[1] - values[0], values[0])
    lower = dr.fma(right_share, values[3] - values[2], values[2])
    return dr.select(inside, dr.fma(bottom_share, lower - upper, upper), outside)


def _polynomial(dr: Any, types: Any, table: Any, start: Any, degree: int, u: Any, v: Any) -> Any:
    """Evaluate bivariate polynomials; their terms start at entries (n,) of a table."""
    result, place = None, (degree + 1) * (degree + 2) // 2
    for power_v in range(degree, -1, -1):
        line = None
        for _ in range(degree - power_v + 1):
            place -= 1
            value = dr.gather(types.Float, table, start + place)
            line = value if line is None else dr.fma(line, u, value)
        result = line if result is None else dr.fma(result, v, line)
    return result


_AT_ONCE = 16  # planes that are shifted before they are resampled: bounds memory


def refocus_sum(
    images: F32, cameras: Sequence[CameraModel], grid: Grid, *, outside: float = 0.0
) -> F32:
    """Sum the cameras' images (camera, row, column) at every voxel: (z, y, x).

    A camera that does not see a voxel counts as `outside` there. Source: thesis, equation 3.3,
    times N. Images are resampled once per slab by cubic B-splines, then bilinearly: at most
    `slabs.DEVIATION_PX` from exact positions. A grid without light paths is a ValueError.
    """
    volume = np.empty(grid.shape, dtype=np.float32)
    for view, rectified, part in _parts(images, cameras, grid, outside, volume):
        if _on_device():
            _sum_planes_on_device(rectified, view.slab, grid, outside, part)
        else:
            tiles = view.tiles
            on_cores(cpu_kernels.sum_planes, len(tiles), rectified, LINEAR, tiles, outside, part)
    return volume


def typical_where_covered(case: Observation) -> F32:
    """Normalise images, with the camera's mean light under reflections, for averages."""
    images = case.normalised_images()
    for image, covered in zip(images, case.repaired.flaws.covered, strict=True):
        image[covered] = image[~covered].mean() if covered.any() and not covered.all() else 0.0
    return images


def count_views(case: Observation, *, seen_only: bool) -> F32 | float:
    """Count the cameras that show something at each voxel: (z, y, x), 1 at least.

    A camera shows nothing where a reflection covers its image. If it does not see the voxel, it
    shows it dark, unless `seen_only` is set.
    """
    covered = case.repaired.flaws.covered
    if not seen_only and not covered.any():
        return float(len(case.cameras))
    uncovered, outside = (~covered).astype(np.float32), 0.0 if seen_only else 1.0
    return np.maximum(refocus_sum(uncovered, case.cameras, case.grid, outside=outside), 1.0)


def refocus_log2(
    images: F32, cameras: Sequence[CameraModel], grid: Grid, floor: float, *, outside: float = 0.0
) -> F32:
    """Sum log2 of the cameras' images at every voxel; arguments as for `refocus_sum`.

    Samples below `floor` are raised to it. Two to the power of n times the result is the product
    of equation 3.4 of the thesis.
    """
    volume = np.empty(grid.shape, dtype=np.float32)
    largest = float(max(images.max(initial=0.0), outside, 1.0))
    for view, rectified, part in _parts(images, cameras, grid, outside, volume):
        if _on_device():
            _multiply_planes_on_device(rectified, view.slab, grid, outside, floor, part)
        else:
            tiles, limits = view.tiles, (outside, floor, 2.0 * largest)
            on_cores(cpu_kernels.multiply_planes, len(tiles), rectified, tiles, *limits, part)
    return volume


def refocus_by_shifts(images: F32, cameras: Sequence[CameraModel], grid: Grid) -> F32:
    """Average whole-pixel shifts of the cameras' images: (z, y, x).

    Source: thesis, equations 2.1 to 2.3, the map-shift-average of cameras on one plane. Images are
    mapped bilinearly to the grid's middle plane. A plane is refocused as the camera nearest to the
    array's centre sees it, which needs only shifts, and then resampled to the grid's voxels by a
    cubic spline, which is below zero next to bright particles. Its coefficients are shifted instead
    of the pixels: filtering before or after a shift is the same.
    """
    view = _whole(tuple(cameras), grid)
    slab, mapped = view.slab, np.empty((len(images), *view.slab.shape), dtype=np.float32)
    resample(coefficients_of(images, LINEAR), LINEAR, view.maps, view.degree, 0.0, mapped)
    mapped /= len(cameras)
    coefficients = coefficients_of(mapped, CUBIC)
    # of several cameras nearest to the array's centre, the one with the smallest coordinates
    centers = np.asarray([camera.center_mm for camera in cameras])
    distance = np.linalg.norm(centers - centers.mean(axis=0), axis=1).round(6)
    nearest = int(np.lexsort((*centers.T, distance))[0])
    shifts = np.rint(slab.middle_shifts - slab.middle_shifts[nearest])
    shifts = shifts - (slab.corners - slab.corners[nearest])[:, None]
    maps = np.ascontiguousarray(view.tiles[:, :, nearest : nearest + 1])
    low, shape = _find_reached(maps)
    maps[..., [0, 3]] -= low
    whole = (shifts + low).astype(np.int64).transpose(1, 0, 2)
    volume = np.empty(grid.shape, dtype=np.float32)
    focused = np.empty((_AT_ONCE, *shape), dtype=np.float32)
    for first in progress_bar(range(0, grid.shape[0], _AT_ONCE), f"shift {len(cameras)} cameras"):
        some = whole[first : first + _AT_ONCE]
        target = focused[: grid.shape[0] - first]
        on_cores(cpu_kernels.sum_shifted, -(-shape[0] // TILE_ROWS), coefficients, some, target)
        for plane, image in enumerate(focused[: len(some)], first):
            affine = np.ascontiguousarray(maps[:, plane : plane + 1])  # one type, one compilation
            out = volume[plane : plane + 1]
            on_cores(cpu_kernels.sum_planes, len(affine), image[None], CUBIC, affine, 0.0, out)
    return volume


def _find_reached(maps: F64) -> tuple[F64, tuple[int, int]]:
    """Find first column, row and padded shape that maps (tile, plane, 1, 6) reach."""
    size = np.array([TILE_COLUMNS, TILE_ROWS])
    starts = maps[..., [0, 3]]
    ends = starts + maps[..., [1, 4]] * size[0] + maps[..., [2, 5]] * size[1]
    low = np.floor(np.minimum(starts, ends).min(axis=(0, 1, 2))) - 1.0
    width, height = (np.ceil(np.maximum(starts, ends).max(axis=(0, 1, 2))) - low).astype(int) + 5
    return low, (int(height), int(width))


def shift_maps(grid: Grid, shifts: F64) -> F64:
    """Make affine maps (tile, plane, camera, 6) of shifts (plane, camera, 2).

    Each shift is one of a whole plane.
    """
    top, left = tile_origins(grid)
    maps = np.zeros((len(top), *shifts.shape[:2], 6))
    maps[..., 0], maps[..., 1] = left[:, None, None] + shifts[..., 0], 1.0
    maps[..., 3], maps[..., 5] = top[:, None, None] + shifts[..., 1], 1.0
    return maps


@dataclass(frozen=True)
class _View:
    """View of one slab by an array, the same for all its frames.

    Attributes
    ----------
    maps, degree : from `rectifying_maps`.
    tiles : from `Slab.tiles`. They come from a matrix product: its threads would go on spinning
        next to the kernels.
    """

    slab: Slab
    maps: F64
    degree: int
    tiles: F64


def _parts(
    images: F32, cameras: Sequence[CameraModel], grid: Grid, outside: float, volume: F32
) -> Iterator[tuple[_View, F32, F32]]:
    """Yield every slab's view, rectified images (camera, height, width) and planes."""
    for view in progress_bar(_views(tuple(cameras), grid), f"refocus, {len(cameras)} cameras"):
        rectified = np.empty((len(images), *view.slab.shape), dtype=np.float32)
        for number in range(len(images)):  # one at a time: its coefficients stay in the cache
            this = slice(number, number + 1)
            coefficients, maps = coefficients_of(images[this], CUBIC), view.maps[this]
            resample(coefficients, CUBIC, maps, view.degree, outside, rectified[this])
        yield view, rectified, volume[view.slab.first : view.slab.first + view.slab.count]


@functools.lru_cache(maxsize=2)
def _views(cameras: tuple[CameraModel, ...], grid: Grid) -> list[_View]:
    return [_view(slab, cameras, grid) for slab in slabs(cameras, grid)]


@functools.lru_cache(maxsize=2)
def _whole(cameras: tuple[CameraModel, ...], grid: Grid) -> _View:
    return _view(make_slab(cameras, grid, 0, grid.shape[0]), cameras, grid)


def _view(slab: Slab, cameras: Sequence[CameraModel], grid: Grid) -> _View:
    return _View(slab, *rectifying_maps(slab, cameras, grid), slab.tiles(grid))


def _on_device() -> bool:
    return backend.choose().kind == "cuda"
