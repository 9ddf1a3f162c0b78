"""Compiled kernel that writes particles into a voxel field."""

from __future__ import annotations

from typing import Any

import numba

_BAND = 16  # planes that one thread fills at a time, so that none writes where another does


@numba.njit(cache=True, parallel=True)
def add_particles(
    first: Any, weights: Any, along_x: Any, along_y: Any, along_z: Any, field: Any
) -> None:
    """Add w p(x) p(y) p(z) of every particle to the field (z, y, x).

    The profiles begin at the voxel `first` (x, y, z); parts outside the field are dropped.
    """
    planes, rows, columns = field.shape
    for band in numba.prange((planes + _BAND - 1) // _BAND):
        begin, end = band * _BAND, min(band * _BAND + _BAND, planes)
        for i in range(len(first)):
            left, top, front = first[i]
            start, stop = max(0, -left), min(along_x.shape[1], columns - left)
            for c in range(max(0, begin - front), min(along_z.shape[1], end - front)):
                for b in range(max(0, -top), min(along_y.shape[1], rows - top)):
                    row = weights[i] * along_z[i, c] * along_y[i, b]
                    for a in range(start, stop):
                        field[front + c, top + b, left + a] += row * along_x[i, a]
