"""Refocusing on the CPU: contiguous reads of rectified images, tile by tile, all planes of a slab inside the tile.

A gather of four pixels per sample costs ten times as much as reading along a row. Inside a tile the map onto a rectified image is affine and
close to a shift, so that whole stretches of a row of voxels fall between the same two rows of pixels, one pixel further per voxel.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

TILE_ROWS, TILE_COLUMNS = 16, 512  # a tile's accumulators and the pixels that it reads stay in the first two caches
_DECADES = 30.0  # a product's range before its logarithm is taken: inside float32's


def _log2_rest() -> tuple[np.float32, ...]:
    """Coefficients of (log2(1 + t) - t) / (t (1 - t)) in powers of t, 0 < t < 1."""
    t = 0.5 - 0.5 * np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    return tuple(np.polynomial.polynomial.polyfit(t, (np.log2(1.0 + t) - t) / (t * (1.0 - t)), 5).astype(np.float32))


_LOG2_REST = _log2_rest()


@numba.njit(cache=True, fastmath=True)
def _stretch(fraction: float, step: float, first: int, count: int) -> int:
    """The voxel at which a position that starts at `fraction` and moves by `step` per voxel enters another pixel."""
    room = 1.0 - fraction if step > 0.0 else fraction
    if room >= abs(step) * (count - first):
        return count
    whole = math.ceil(room / step) if step > 0.0 else math.floor(room / -step) + 1
    return min(count, first + max(1, int(whole)))


@numba.njit(cache=True, fastmath=True)
def _folded(total: Any, sample: Any, fold: Any) -> Any:
    """total + sample for a `fold` of one number, total * max(sample, fold[0]) for one of two: its type, so no branch is left at run time."""
    return total + sample if len(fold) == 1 else total * max(sample, fold[0])


@numba.njit(cache=True, fastmath=True)
def _fold_samples(image: Any, affine: Any, row: int, outside: Any, fold: Any, target: Any) -> None:
    """Fold bilinear samples into the target along one row of a tile."""
    height, width = image.shape
    column_start, column_step = affine[0] + affine[2] * row, affine[1] - 1.0
    row_start, row_step = affine[3] + affine[5] * row, affine[4]
    first, count = 0, len(target)
    while first < count:
        x, y = column_start + column_step * first, row_start + row_step * first  # x less the shift of one pixel per voxel
        shift, above = math.floor(x), math.floor(y)
        end = min(_stretch(x - shift, column_step, first, count), _stretch(y - above, row_step, first, count))
        low, high = min(max(first, -shift), end), max(min(end, width - 1 - shift), first)
        if above < 0 or above >= height - 1 or high <= low:
            low = high = end
        for i in range(first, low):
            target[i] = _folded(target[i], outside, fold)
        for i in range(high, end):
            target[i] = _folded(target[i], outside, fold)
        if high > low:
            right, right_step = np.float32(x - shift + column_step * (low - first)), np.float32(column_step)
            down, down_step = np.float32(y - above + row_step * (low - first)), np.float32(row_step)
            upper = image[above, low + shift : high + shift + 1]
            lower = image[above + 1, low + shift : high + shift + 1]
            inner = target[low:high]
            for i in range(len(inner)):
                step = np.float32(np.int32(i))
                share = right + right_step * step
                over = upper[i] + share * (upper[i + 1] - upper[i])
                under = lower[i] + share * (lower[i + 1] - lower[i])
                inner[i] = _folded(inner[i], over + (down + down_step * step) * (under - over), fold)
        first = end


@numba.njit(cache=True, fastmath=True)
def _add_log2(product: Any, total: Any) -> None:
    """total += log2(product), product = 1; within 5e-6.

    Read as an integer, a float is its exponent and, linear in between, its mantissa 1 + t: 2^23 (127 + e + t). What is missing is log2(1 + t) - t.
    """
    bits = product.view(np.int32)
    mantissa = np.empty(len(product), dtype=np.float32)
    fraction = mantissa.view(np.int32)
    for i in range(len(bits)):
        total[i] += np.float32(bits[i]) * np.float32(2.0**-23) - np.float32(127.0)
        fraction[i] = (bits[i] & 0x7FFFFF) | 0x3F800000
    c0, c1, c2, c3, c4, c5 = _LOG2_REST
    for i in range(len(mantissa)):
        t = mantissa[i] - np.float32(1.0)
        total[i] += t * (np.float32(1.0) - t) * (c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))))
        product[i] = 1.0


@numba.njit(cache=True, parallel=True, fastmath=True)
def sum_planes(rectified: Any, maps: Any, outside: float, out: Any) -> None:
    """out[k] = the sum of all cameras' samples on plane k.

    Parameters
    ----------
    rectified : (camera, height, width) float32.
    maps : (tile, plane, camera, 6): column at the tile's first voxel, its steps along x and y; row, its steps along x and y.
    outside : sample where a map leaves the rectified image.
    out : (plane, y, x) float32, written.
    """
    planes, rows, columns = out.shape
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    value = np.float32(outside)
    for tile in numba.prange(maps.shape[0]):
        top, left = tile // across * TILE_ROWS, tile % across * TILE_COLUMNS
        height, width = min(TILE_ROWS, rows - top), min(TILE_COLUMNS, columns - left)
        total = np.empty((height, width), dtype=np.float32)
        for plane in range(planes):
            total[:] = 0.0
            for camera in range(len(rectified)):
                for row in range(height):
                    _fold_samples(rectified[camera], maps[tile, plane, camera], row, value, (value,), total[row])
            for row in range(height):
                out[plane, top + row, left : left + width] = total[row]


@numba.njit(cache=True, parallel=True, fastmath=True)
def multiply_planes(rectified: Any, maps: Any, outside: float, floor: float, largest: float, out: Any) -> None:
    """out[k] = the sum over cameras of log2 of their samples on plane k, each raised to `floor` at least; arguments as in `sum_planes`.

    `largest` is the largest sample. Samples are multiplied, and the logarithm is taken of the product just before it could leave float32's range.
    """
    planes, rows, columns = out.shape
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    value, smallest = max(np.float32(outside), np.float32(floor)), np.float32(floor)
    group = max(1, int(_DECADES / max(-math.log10(floor), math.log10(max(largest, 10.0)))))
    for tile in numba.prange(maps.shape[0]):
        top, left = tile // across * TILE_ROWS, tile % across * TILE_COLUMNS
        height, width = min(TILE_ROWS, rows - top), min(TILE_COLUMNS, columns - left)
        product, total = np.empty((height, width), dtype=np.float32), np.empty((height, width), dtype=np.float32)
        for plane in range(planes):
            total[:] = 0.0
            product[:] = 1.0
            for camera in range(len(rectified)):
                for row in range(height):
                    _fold_samples(rectified[camera], maps[tile, plane, camera], row, value, (smallest, smallest), product[row])
                if camera % group == group - 1 or camera == len(rectified) - 1:
                    for row in range(height):
                        _add_log2(product[row], total[row])
            for row in range(height):
                out[plane, top + row, left : left + width] = total[row]
