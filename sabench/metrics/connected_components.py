"""Connected components (26 neighbours) of bright voxels of a volume.

They are found from runs of voxels along x, which takes a few bytes per run instead of a label per
voxel.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from sabench.utils.arrays import F32, F64


def component_sums(volume: F32, floor: float) -> F64:
    """Sum E, E x, E y and E z over the voxels of each component of E >= floor.

    Returns (n, 4), in the order of the components' first voxels.
    """
    counts = np.zeros(volume.shape[:2], dtype=np.int64)
    _count_runs(volume, floor, counts)
    first = np.append(0, np.cumsum(counts))
    start, stop = np.empty(first[-1], dtype=np.int32), np.empty(first[-1], dtype=np.int32)
    _find_runs(volume, floor, first, start, stop)
    component, count = _join_runs(start, stop, first, volume.shape[0], volume.shape[1])
    sums = np.zeros((count, 4))
    _sum_runs(volume, start, stop, first, component, sums)
    return sums


@numba.njit(cache=True, parallel=True)
def _count_runs(volume: Any, floor: float, counts: Any) -> None:
    """Count the runs along x of voxels that reach the floor, into counts[z, y]."""
    for z in numba.prange(volume.shape[0]):
        for y in range(volume.shape[1]):
            before = False
            for value in volume[z, y]:
                bright = value >= floor
                counts[z, y] += bright and not before
                before = bright


@numba.njit(cache=True, parallel=True)
def _find_runs(volume: Any, floor: float, first: Any, start: Any, stop: Any) -> None:
    """Find the ends [start, stop) of the runs.

    The first run of a row is first[z * rows + y].
    """
    rows, columns = volume.shape[1:]
    for z in numba.prange(volume.shape[0]):
        for y in range(rows):
            run = first[z * rows + y]
            before = False
            for x in range(columns):
                bright = volume[z, y, x] >= floor
                if bright and not before:
                    start[run] = x
                elif before and not bright:
                    stop[run] = x
                    run += 1
                before = bright
            if before:
                stop[run] = columns


@numba.njit(cache=True)
def _join_runs(start: Any, stop: Any, first: Any, planes: int, rows: int) -> Any:
    """Find the component of each run, and the number of components.

    This is a union-find whose root is a component's first run.
    """
    parent = np.arange(len(start), dtype=np.int32)
    for z in range(planes):
        for y in range(rows):
            row = z * rows + y
            if y > 0:
                _join_rows(parent, start, stop, first, row, row - 1)
            if z > 0:
                for other in range(max(0, y - 1), min(rows, y + 2)):
                    _join_rows(parent, start, stop, first, row, (z - 1) * rows + other)
    count = 0
    # a parent comes before its runs and is a component's number by then
    for run in range(len(parent)):
        if parent[run] == run:
            parent[run] = count
            count += 1
        else:
            parent[run] = parent[parent[run]]
    return parent, count


@numba.njit(cache=True)
def _join_rows(parent: Any, start: Any, stop: Any, first: Any, row: int, other: int) -> None:
    """Join the runs of two neighbouring rows that touch, corners included."""
    i, j = first[row], first[other]
    while i < first[row + 1] and j < first[other + 1]:
        if start[i] <= stop[j] and start[j] <= stop[i]:
            a, b = _root(parent, i), _root(parent, j)
            parent[max(a, b)] = min(a, b)
        if stop[i] < stop[j]:
            i += 1
        else:
            j += 1


@numba.njit(cache=True)
def _root(parent: Any, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@numba.njit(cache=True)
def _sum_runs(volume: Any, start: Any, stop: Any, first: Any, component: Any, sums: Any) -> None:
    rows = volume.shape[1]
    for row in range(len(first) - 1):
        z, y = row // rows, row % rows
        for run in range(first[row], first[row + 1]):
            total = sums[component[run]]
            for x in range(start[run], stop[run]):
                weight = np.float64(volume[z, y, x])
                total[0] += weight
                total[1] += weight * x
                total[2] += weight * y
                total[3] += weight * z
