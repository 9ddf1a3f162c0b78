"""Local maxima of a volume among 26 neighbours, with sub-voxel positions."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.utils.arrays import F32, F64

# marks of voxels that no neighbour exceeds: higher than all, equal to some, already counted
_SINGLE, _TIED, _SEEN = 1, 2, 3


def fitted_maxima(volume: F32, floor: float) -> F64:
    """Locate the maxima of E >= floor as fractional voxel indices (n, 3) of x, y, z.

    They are in the order of their first voxels.
    A voxel higher than its 26 neighbours is a maximum; so is a plateau, connected voxels of one
    value, that no neighbour exceeds, at the mean of its voxels.
    """
    mark = np.zeros(volume.shape, dtype=np.uint8)
    _mark_maxima(volume, floor, mark)
    return np.asarray(
        _collect(volume, mark, np.empty((np.count_nonzero(mark), 3))), dtype=np.float64
    )


@numba.njit(cache=True, parallel=True)
def _mark_maxima(volume: Any, floor: float, mark: Any) -> None:
    planes, rows, columns = volume.shape
    for z in numba.prange(planes):
        for y in range(rows):
            for x in range(columns):
                if volume[z, y, x] >= floor:
                    mark[z, y, x] = _mark_of(volume, z, y, x)


@numba.njit(cache=True)
def _mark_of(volume: Any, z: int, y: int, x: int) -> int:
    value = volume[z, y, x]
    equals = 0
    for c in range(max(z - 1, 0), min(z + 2, volume.shape[0])):
        for b in range(max(y - 1, 0), min(y + 2, volume.shape[1])):
            for a in range(max(x - 1, 0), min(x + 2, volume.shape[2])):
                if volume[c, b, a] > value:
                    return 0
                equals += volume[c, b, a] == value
    return _SINGLE if equals == 1 else _TIED  # a voxel equals itself


@numba.njit(cache=True)
def _collect(volume: Any, mark: Any, found: Any) -> Any:
    count = 0
    for z in range(mark.shape[0]):
        for y in range(mark.shape[1]):
            for x in range(mark.shape[2]):
                if mark[z, y, x] == _SINGLE:
                    _put(found, count, _fit(volume, z, y, x))
                    count += 1
                elif mark[z, y, x] == _TIED:
                    highest, position = _plateau(volume, mark, z, y, x)
                    if highest:
                        _put(found, count, position)
                        count += 1
    return found[:count].copy()


@numba.njit(cache=True)
def _put(rows: Any, number: int, values: Any) -> None:
    """Set a row, value by value.

    numba's copy of an array takes seconds to compile, with the message of its error.
    """
    for axis in range(3):
        rows[number, axis] = values[axis]


@numba.njit(cache=True)
def _plateau(volume: Any, mark: Any, z: int, y: int, x: int) -> Any:
    """Fill a plateau from its first voxel.

    Returns whether it is a maximum, and its mean (x, y, z).
    """
    value, highest, total, size = volume[z, y, x], True, np.zeros(3), 0
    waiting = [(z, y, x)]
    mark[z, y, x] = _SEEN
    while waiting:
        k, j, i = waiting.pop()
        size += 1
        total[0] += i
        total[1] += j
        total[2] += k
        for c in range(max(k - 1, 0), min(k + 2, volume.shape[0])):
            for b in range(max(j - 1, 0), min(j + 2, volume.shape[1])):
                for a in range(max(i - 1, 0), min(i + 2, volume.shape[2])):
                    if volume[c, b, a] == value and mark[c, b, a] == _TIED:
                        mark[c, b, a] = _SEEN
                        waiting.append((c, b, a))
                    # an unmarked voxel of the same value has a higher neighbour
                    highest &= volume[c, b, a] != value or mark[c, b, a] == _SEEN
    return highest, total / size


@numba.njit(cache=True)
def _fit(volume: Any, z: int, y: int, x: int) -> Any:
    position = np.array([np.float64(x), np.float64(y), np.float64(z)])
    if 0 < x < volume.shape[2] - 1:
        position[0] += three_point(volume[z, y, x - 1], volume[z, y, x], volume[z, y, x + 1])
    if 0 < y < volume.shape[1] - 1:
        position[1] += three_point(volume[z, y - 1, x], volume[z, y, x], volume[z, y + 1, x])
    if 0 < z < volume.shape[0] - 1:
        position[2] += three_point(volume[z - 1, y, x], volume[z, y, x], volume[z + 1, y, x])
    return position


@numba.njit(cache=True)
def three_point(before: float, value: float, after: float) -> float:
    """Compute the offset of the vertex of a Gaussian through three values.

    The middle value is the highest; the offset lies between -1/2 and 1/2. Where a neighbour is 0
    and has no logarithm, it is that of the centroid of the three values.

    Source: Willert and Gharib, Exp. Fluids 10 (1991) 181-193.
    """
    a, b, c = float(before), float(value), float(after)
    if a <= 0.0 or c <= 0.0:
        return (c - a) / (a + b + c)
    a, b, c = math.log(a), math.log(b), math.log(c)
    return 0.5 * (a - c) / (a - 2.0 * b + c)
