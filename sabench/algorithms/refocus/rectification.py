"""Rectification: images resampled once onto a plane.

Other planes need shifts and scales only.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores

# degrees of splines as lengths of tuples, which are part of their types: kernels are compiled for
# each
LINEAR, CUBIC = (1,), (1, 1, 1)
# of the cubic B-spline's inverse filter: Unser, IEEE Signal Process. Mag. 16 (1999) 22-38
POLE = math.sqrt(3.0) - 2.0
# terms after which the pole's powers are below single precision
TERMS = math.ceil(math.log(np.finfo(np.float32).eps) / math.log(-POLE))
_LINES = 64  # lines filtered side by side, so that the recursion runs over contiguous numbers


def coefficients_of(images: F32, spline: tuple[int, ...]) -> F32:
    """Compute coefficients (n, rows + 3, columns + 3) of the B-spline.

    It is mirrored at the borders.
    """
    if spline == LINEAR:
        return np.pad(images, ((0, 0), (1, 2), (1, 2)), mode="reflect")
    count, rows, columns = images.shape
    padded: npt.NDArray[np.float32] = np.empty((count, rows + 3, columns + 3), dtype=np.float32)
    on_cores(_filter_along_rows, count * -(-rows // _LINES), images, padded)
    on_cores(_filter_along_columns, count * -(-(columns + 3) // _LINES), padded)
    return padded


@numba.njit(cache=True, nogil=True, fastmath=True)
def _filter_along_rows(jobs: slice, images: Any, padded: Any) -> None:
    _, rows, columns = images.shape
    strips = (rows + _LINES - 1) // _LINES
    for job in range(jobs.start, jobs.stop):
        image, first = job // strips, job % strips * _LINES
        lines = np.empty((columns, min(_LINES, rows - first)), dtype=np.float32)
        for i in range(lines.shape[1]):
            for column in range(columns):
                lines[column, i] = images[image, first + i, column]
        _filter(lines)
        for i in range(lines.shape[1]):
            row = padded[image, first + i + 1]
            for column in range(columns):
                row[column + 1] = lines[column, i]
            row[0], row[columns + 1], row[columns + 2] = row[2], row[columns - 1], row[columns - 2]


@numba.njit(cache=True, nogil=True, fastmath=True)
def _filter_along_columns(jobs: slice, padded: Any) -> None:
    _, rows, columns = padded.shape
    strips = (columns + _LINES - 1) // _LINES
    for job in range(jobs.start, jobs.stop):
        image, first = padded[job // strips], job % strips * _LINES
        strip = image[:, first : first + _LINES]
        _filter(strip[1:-2])
        for i in range(strip.shape[1]):
            strip[0, i] = strip[2, i]
            strip[rows - 2, i] = strip[rows - 4, i]
            strip[rows - 1, i] = strip[rows - 5, i]


@inner_kernel(fastmath=True)
def _filter(lines: Any) -> None:
    """Apply the inverse filter down the first axis, in place, to adjacent lines."""
    length, count = lines.shape
    pole, gain = np.float32(POLE), np.float32((1.0 - POLE) * (1.0 - 1.0 / POLE))
    last = np.float32(POLE / (POLE * POLE - 1.0))
    start, power = np.zeros(count, dtype=np.float32), np.float32(1.0)
    for k in range(min(TERMS, length)):
        for i in range(count):
            start[i] += power * lines[k, i]
        power *= pole
    for i in range(count):
        lines[0, i] = gain * start[i]
    for k in range(1, length):
        now, before = lines[k], lines[k - 1]
        for i in range(count):
            now[i] = gain * now[i] + pole * before[i]
    now, before = lines[length - 1], lines[length - 2]
    for i in range(count):
        now[i] = last * (now[i] + pole * before[i])
    for k in range(length - 2, -1, -1):
        now, after = lines[k], lines[k + 1]
        for i in range(count):
            now[i] = pole * (after[i] - now[i])


def resample(
    coefficients: F32, spline: tuple[int, ...], maps: F64, degree: int, outside: float, out: F32
) -> None:
    """Evaluate each image's spline at its mapped positions.

    Parameters
    ----------
    coefficients : from `coefficients_of`.
    spline : LINEAR or CUBIC.
    maps : (n, 2, terms) polynomials of column and row in u, v from -1 to 1 across the output,
        ordered as in `PlaneMap`.
    degree : of the polynomials.
    outside : value of output pixels that lie outside an image's pixel centres.
    out : (n, height, width), written; never below zero, where a spline would undershoot next to
        bright pixels.
    """
    rows = math.prod(out.shape[:2])
    on_cores(_resample, rows, coefficients, spline, maps, degree, outside, out)


@numba.njit(cache=True, nogil=True, fastmath=True)
def _resample(
    jobs: slice, coefficients: Any, spline: Any, maps: Any, degree: int, outside: float, out: Any
) -> None:
    _, height, width = out.shape
    for job in range(jobs.start, jobs.stop):
        number, line = job // height, job % height
        v = 2.0 * line / max(height - 1, 1) - (1.0 if height > 1 else 0.0)
        column = _along_row(maps[number, 0], degree, v)
        row = _along_row(maps[number, 1], degree, v)
        columns, rows = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.float32)
        _evaluate(column, columns)
        _evaluate(row, rows)
        _interpolate(
            coefficients[number], spline, columns, rows, np.float32(outside), out[number, line]
        )


@inner_kernel(fastmath=True)
def _along_row(polynomial: Any, degree: int, v: float) -> Any:
    """Evaluate coefficients in u of a bivariate polynomial at a fixed v."""
    line = np.zeros(degree + 1)
    start, power = 0, 1.0
    for power_v in range(degree + 1):
        for power_u in range(degree - power_v + 1):
            line[power_u] += power * polynomial[start + power_u]
        start += degree - power_v + 1
        power *= v
    return line


@inner_kernel(fastmath=True)
def _evaluate(line: Any, out: Any) -> None:
    """Evaluate a polynomial at evenly spaced u from -1 to 1 by vectors of sums."""
    step, start = 2.0 / max(len(out) - 1, 1), 1.0 if len(out) > 1 else 0.0
    value = np.full(len(out), line[-1])
    for k in range(len(line) - 2, -1, -1):
        c = line[k]
        for i in range(len(out)):
            value[i] = value[i] * (np.int32(i) * step - start) + c
    for i in range(len(out)):
        out[i] = value[i]


@inner_kernel(fastmath=True)
def _interpolate(padded: Any, spline: Any, columns: Any, rows: Any, outside: Any, out: Any) -> None:
    """Interpolate with 4 x 4 weights, computed in separate loops to run on vectors."""
    last_row, last_column, pitch = (
        np.float32(padded.shape[0] - 4),
        np.float32(padded.shape[1] - 4),
        np.uint32(padded.shape[1]),
    )
    zero, flat, count = np.float32(0.0), padded.ravel(), len(out)
    corner, across, down = (
        np.empty(count, dtype=np.uint32),
        np.empty((4, count), dtype=np.float32),
        np.empty((4, count), dtype=np.float32),
    )
    for i in range(count):
        column, row = min(max(columns[i], zero), last_column), min(max(rows[i], zero), last_row)
        left, top = np.int32(column), np.int32(row)
        across[0, i], across[1, i], across[2, i], across[3, i] = weights(
            spline, column - np.float32(left)
        )
        down[0, i], down[1, i], down[2, i], down[3, i] = weights(spline, row - np.float32(top))
        corner[i] = np.uint32(top) * pitch + np.uint32(left)
    for i in range(count):
        total, k = zero, corner[i]
        for line in range(4):
            if len(spline) > 1 or line in (1, 2):
                over = across[1, i] * flat[k + 1] + across[2, i] * flat[k + 2]
                if len(spline) > 1:
                    over += across[0, i] * flat[k] + across[3, i] * flat[k + 3]
                total += down[line, i] * over
            k += pitch
        out[i] = max(total, zero)
    for i in range(count):
        inside = (
            (columns[i] >= zero)
            & (rows[i] >= zero)
            & (columns[i] <= last_column)
            & (rows[i] <= last_row)
        )
        out[i] = out[i] if inside else outside


@inner_kernel(fastmath=True)
def weights(spline: Any, t: Any) -> Any:
    """Compute B-spline weights of the pixels -1, 0, 1, 2 at the fraction t."""
    sixth, one = np.float32(1.0 / 6.0), np.float32(1.0)
    s = one - t
    if len(spline) == 1:
        return np.float32(0.0), s, t, np.float32(0.0)
    before, after = sixth * s * s * s, sixth * t * t * t
    return (
        before,
        np.float32(4.0 / 6.0) - t * t * (one - np.float32(0.5) * t),
        np.float32(4.0 / 6.0) - s * s * (one - np.float32(0.5) * s),
        after,
    )
