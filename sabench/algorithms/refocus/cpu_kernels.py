"""Refocusing on the CPU.

Rectified images are read contiguously, tile by tile, with all planes of a slab inside the tile: a
gather of four pixels per sample takes ten times as long as reading along a row. Inside a tile the
map onto a rectified image is affine and close to a shift, so that long stretches of a row of
voxels fall between the same two rows of pixels, one pixel further per voxel.
"""

import math
from typing import Any

import numpy as np

from sabench.algorithms.refocus.rectification import LINEAR, weights
from sabench.utils.compiled import inner_kernel, numba

# a tile's accumulators and the pixels that it reads stay in the first two caches
TILE_ROWS, TILE_COLUMNS = 16, 512
# columns per row: four rows that drift by less are treated as aligned, which misses by 1.5
# times this at most
_SHEAR = 3e-4
_DECADES = 30.0  # a product's range before its logarithm is taken: inside float32's


# coefficients of (log2(1 + t) - t) / (t (1 - t)) in powers of t, 0 < t < 1
_T = 0.5 - 0.5 * np.cos(np.pi * (np.arange(64) + 0.5) / 64)
_REST = np.polynomial.polynomial.polyfit(_T, (np.log2(1.0 + _T) - _T) / (_T * (1.0 - _T)), 5)
_LOG2_REST = tuple(_REST.astype(np.float32))


@inner_kernel(fastmath=True)
def _stretch(fraction: float, step: float, first: int, count: int) -> int:
    """Find the voxel where a position, moving by `step`, enters another pixel."""
    room = 1.0 - fraction if step > 0.0 else fraction
    if room >= abs(step) * (count - first):
        return count
    whole = math.ceil(room / step) if step > 0.0 else math.floor(room / -step) + 1
    return min(count, first + max(1, int(whole)))


@inner_kernel(fastmath=True, forceinline=True)
def _fold(total: Any, sample: Any, fold: Any) -> Any:
    """Return total + sample or, by the type of `fold`, total * max(sample, fold[0])."""
    return total + sample if len(fold) == 1 else total * max(sample, fold[0])


@inner_kernel(fastmath=True)
def _fold_row(
    image: Any, spline: Any, affine: Any, row: int, begin: int, outside: Any, fold: Any, target: Any
) -> None:
    """Fold samples into the target, a row of a tile from column `begin` on."""
    padding = 0 if len(spline) == 1 else 2
    height, width = image.shape[0] - padding, image.shape[1] - padding
    column_start, column_step = affine[0] + affine[2] * row + affine[1] * begin, affine[1] - 1.0
    row_start, row_step = affine[3] + affine[5] * row + affine[4] * begin, affine[4]
    first, count = 0, len(target)
    while first < count:
        x, y = (
            column_start + column_step * first,
            row_start + row_step * first,
        )  # x less the shift of one pixel per voxel
        shift, above = math.floor(x), math.floor(y)
        end = min(
            _stretch(x - shift, column_step, first, count),
            _stretch(y - above, row_step, first, count),
        )
        low, high = min(max(first, -shift), end), max(min(end, width - 1 - shift), first)
        if above < 0 or above >= height - 1 or high <= low:
            low = high = end
        for i in range(first, low):
            target[i] = _fold(target[i], outside, fold)
        for i in range(high, end):
            target[i] = _fold(target[i], outside, fold)
        if high > low:
            start = (
                np.float32(x - shift + column_step * (low - first)),
                np.float32(y - above + row_step * (low - first)),
            )
            step = np.float32(column_step), np.float32(row_step)
            _interpolate(image, spline, (low + shift, above), start, step, fold, target[low:high])
        first = end


@inner_kernel(fastmath=True, forceinline=True)
def _interpolate(
    image: Any, spline: Any, corner: Any, start: Any, step: Any, fold: Any, target: Any
) -> None:
    """Fold samples between two rows of an image from `corner` into the target."""
    (left, top), (right, down), (right_step, down_step) = corner, start, step
    upper, lower = image[top, left:], image[top + 1, left:]
    if len(spline) == 1:
        for i in range(len(target)):
            share, below = (
                right + right_step * np.float32(np.int32(i)),
                down + down_step * np.float32(np.int32(i)),
            )
            over = upper[i] + share * (upper[i + 1] - upper[i])
            under = lower[i] + share * (lower[i + 1] - lower[i])
            target[i] = _fold(target[i], over + below * (under - over), fold)
    else:
        p, q, r, s = upper, lower, image[top + 2, left:], image[top + 3, left:]
        for i in range(len(target)):
            a0, a1, a2, a3 = weights(spline, right + right_step * np.float32(np.int32(i)))
            b0, b1, b2, b3 = weights(spline, down + down_step * np.float32(np.int32(i)))
            over = b0 * (a0 * p[i] + a1 * p[i + 1] + a2 * p[i + 2] + a3 * p[i + 3]) + b1 * (
                a0 * q[i] + a1 * q[i + 1] + a2 * q[i + 2] + a3 * q[i + 3]
            )
            under = b2 * (a0 * r[i] + a1 * r[i + 1] + a2 * r[i + 2] + a3 * r[i + 3]) + b3 * (
                a0 * s[i] + a1 * s[i + 1] + a2 * s[i + 2] + a3 * s[i + 3]
            )
            target[i] = _fold(target[i], over + under, fold)


@inner_kernel(fastmath=True)
def _fold_tile(
    image: Any, spline: Any, affine: Any, outside: Any, fold: Any, total: Any, size: Any
) -> None:
    """Fold one camera's samples into a tile of rows TILE_COLUMNS apart in `total`."""
    rows, columns = size
    flat, fours = image.ravel(), 0
    if len(spline) == 1 and abs(affine[2]) <= _SHEAR:
        fours = rows // 4 * 4
        for row in range(0, fours, 4):
            _fold_four(image, flat, spline, affine, row, outside, fold, total, columns)
    for row in range(fours, rows):
        start = row * TILE_COLUMNS
        _fold_row(image, spline, affine, row, 0, outside, fold, total[start : start + columns])


@inner_kernel(fastmath=True)
def _fold_four(
    image: Any,
    flat: Any,
    spline: Any,
    affine: Any,
    row: int,
    outside: Any,
    fold: Any,
    total: Any,
    columns: int,
) -> None:
    """Fold samples into four rows of a tile that share rows of pixels and positions."""
    column_step, row_step = affine[1] - 1.0, affine[4]
    first = 0
    while first < columns:
        x = affine[0] + affine[2] * row + column_step * first
        y = affine[3] + affine[5] * row + row_step * first
        # less the shift of one pixel per row
        x_last, y_last = x + 3.0 * affine[2], y + 3.0 * (affine[5] - 1.0)
        shift, above = math.floor(x), math.floor(y)
        shift_last, above_last = math.floor(x_last), math.floor(y_last)
        end = min(
            _stretch(x - shift, column_step, first, columns),
            _stretch(y - above, row_step, first, columns),
        )
        end = min(
            end,
            _stretch(x_last - shift_last, column_step, first, columns),
            _stretch(y_last - above_last, row_step, first, columns),
        )
        inside = (
            first + shift >= 0
            and end + shift < image.shape[1]
            and above >= 0
            and above + 4 < image.shape[0]
        )
        if inside and shift == shift_last and above == above_last:
            corner = np.uint32(above * image.shape[1] + shift + first)
            start = np.float32(x - shift + 1.5 * affine[2]), np.float32(y - above)
            step = np.float32(column_step), np.float32(row_step), np.float32(affine[5] - 1.0)
            target = total[row * TILE_COLUMNS + first : (row + 3) * TILE_COLUMNS + end]
            pitch = np.uint32(image.shape[1])
            _interpolate_four(flat, pitch, corner, start, step, fold, target, end - first)
        else:
            for tile_row in range(row, row + 4):
                place = tile_row * TILE_COLUMNS
                target = total[place + first : place + end]
                _fold_row(image, spline, affine, tile_row, first, outside, fold, target)
        first = end


@inner_kernel(fastmath=True, forceinline=True)
def _interpolate_four(
    flat: Any, pitch: Any, corner: Any, start: Any, step: Any, fold: Any, target: Any, count: int
) -> None:
    """Fold samples between five rows of an image into four; `step` by column, by row."""
    (right, below), (right_step, down_step, row_step) = start, step
    width = count + 1
    k1, k2 = corner + pitch, corner + pitch * np.uint32(2)
    k3, k4 = corner + pitch * np.uint32(3), corner + pitch * np.uint32(4)
    p, q, r = flat[corner : corner + width], flat[k1 : k1 + width], flat[k2 : k2 + width]
    s, t = flat[k3 : k3 + width], flat[k4 : k4 + width]
    below_1, below_2 = below + row_step, below + np.float32(2.0) * row_step
    below_3 = below + np.float32(3.0) * row_step
    for i in range(count):
        along = np.float32(np.int32(i))
        share, down = right + right_step * along, down_step * along
        row_0, row_1 = p[i] + share * (p[i + 1] - p[i]), q[i] + share * (q[i + 1] - q[i])
        row_2, row_3 = r[i] + share * (r[i + 1] - r[i]), s[i] + share * (s[i + 1] - s[i])
        row_4 = t[i] + share * (t[i + 1] - t[i])
        k = i + TILE_COLUMNS, i + 2 * TILE_COLUMNS, i + 3 * TILE_COLUMNS
        target[i] = _fold(target[i], row_0 + (below + down) * (row_1 - row_0), fold)
        target[k[0]] = _fold(target[k[0]], row_1 + (below_1 + down) * (row_2 - row_1), fold)
        target[k[1]] = _fold(target[k[1]], row_2 + (below_2 + down) * (row_3 - row_2), fold)
        target[k[2]] = _fold(target[k[2]], row_3 + (below_3 + down) * (row_4 - row_3), fold)


@inner_kernel(fastmath=True)
def _add_log2(product: Any, total: Any) -> None:
    """Add log2(product) to total and set product to 1; within 5e-6.

    Read as an integer, a float is its exponent and its mantissa 1 + t: 2^23 (127 + e + t). What is
    missing is log2(1 + t) - t.
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
        rest = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))
        total[i] += t * (np.float32(1.0) - t) * rest
        product[i] = 1.0


@numba.njit(cache=True, nogil=True, fastmath=True)
def sum_planes(
    jobs: slice, rectified: Any, spline: Any, maps: Any, outside: float, out: Any
) -> None:
    """Sum all cameras' samples on plane k into out[k].

    Parameters
    ----------
    rectified : (camera, height, width) float32, or their `rectification.coefficients_of`.
    spline : LINEAR for images, CUBIC for coefficients.
    maps : (tile, plane, camera, 6): column at the tile's first voxel, its steps along x and y; row,
        its steps along x and y.
    outside : sample where a map leaves the rectified image.
    out : (plane, y, x) float32, written.
    """
    planes, rows, columns = out.shape
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    value = np.float32(outside)
    for tile in range(jobs.start, jobs.stop):
        top, left = tile // across * TILE_ROWS, tile % across * TILE_COLUMNS
        height, width = min(TILE_ROWS, rows - top), min(TILE_COLUMNS, columns - left)
        total = np.empty(TILE_ROWS * TILE_COLUMNS, dtype=np.float32)
        for plane in range(planes):
            total[:] = 0.0
            for camera in range(len(rectified)):
                image, affine = rectified[camera], maps[tile, plane, camera]
                _fold_tile(image, spline, affine, value, (value,), total, (height, width))
            for row in range(height):
                target = out[plane, top + row, left : left + width]
                for i in range(width):
                    target[i] = total[row * TILE_COLUMNS + i]


@numba.njit(cache=True, nogil=True, fastmath=True)
def multiply_planes(
    jobs: slice, rectified: Any, maps: Any, outside: float, floor: float, largest: float, out: Any
) -> None:
    """Fill in out[k]: the sum over cameras of log2 of their samples on plane k.

    Each sample is raised to `floor` at least; arguments as in `sum_planes`, linear.

    `largest` is the largest sample. Samples are multiplied, and the logarithm is taken of the
    product just before it could leave float32's range.
    """
    planes, rows, columns = out.shape
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    value, smallest = max(np.float32(outside), np.float32(floor)), np.float32(floor)
    group = max(1, int(_DECADES / max(-math.log10(floor), math.log10(max(largest, 10.0)))))
    for tile in range(jobs.start, jobs.stop):
        top, left = tile // across * TILE_ROWS, tile % across * TILE_COLUMNS
        height, width = min(TILE_ROWS, rows - top), min(TILE_COLUMNS, columns - left)
        product = np.empty(TILE_ROWS * TILE_COLUMNS, dtype=np.float32)
        total = np.empty(TILE_ROWS * TILE_COLUMNS, dtype=np.float32)
        for plane in range(planes):
            total[:] = 0.0
            product[:] = 1.0
            for camera in range(len(rectified)):
                image, affine = rectified[camera], maps[tile, plane, camera]
                fold = smallest, smallest
                _fold_tile(image, LINEAR, affine, value, fold, product, (height, width))
                if camera % group == group - 1 or camera == len(rectified) - 1:
                    _add_log2(product, total)
            for row in range(height):
                target = out[plane, top + row, left : left + width]
                for i in range(width):
                    target[i] = total[row * TILE_COLUMNS + i]


@numba.njit(cache=True, nogil=True, fastmath=True)
def sum_shifted(jobs: slice, images: Any, shifts: Any, out: Any) -> None:
    """Sum all cameras' images, each shifted by whole pixels, into out[k].

    Pixels beyond an image are 0.

    Parameters
    ----------
    images : (camera, height, width) float32.
    shifts : (plane, camera, 2) integers: column and row of an image that come to the output's
        first.
    out : (plane, rows, columns) float32, written.
    """
    planes, rows, columns = out.shape
    for strip in range(jobs.start, jobs.stop):
        for plane in range(planes):
            for row in range(strip * TILE_ROWS, min(strip * TILE_ROWS + TILE_ROWS, rows)):
                target = out[plane, row]
                target[:] = 0.0
                for camera in range(len(images)):
                    column, line = shifts[plane, camera, 0], row + shifts[plane, camera, 1]
                    low, high = max(0, -column), min(columns, images.shape[2] - column)
                    if 0 <= line < images.shape[1] and low < high:
                        source = images[camera, line, low + column : high + column]
                        inner = target[low:high]
                        for i in range(len(inner)):
                            inner[i] += source[i]
