"""Random packing of ellipsoids without overlap.

A grid with cells as wide as the largest bubble holds the bubbles that are already there; a new
one is compared with those of 27 cells.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.errors import InputError
from sabench.worlds.library.overlaps import contact_factor, shapes_of

_TRIES, _ROUNDS = 64, 200  # places that are tried for each bubble at a time, and how often


def place_ellipsoids(
    semi_axes_mm: F64, rotation: F64, propose: Callable[[I64, int], F64], what: str
) -> F64:
    """Place ellipsoids so that none overlap, the largest first: centres (n, 3).

    Parameters
    ----------
    semi_axes_mm, rotation : (n, 3), (n, 3, 3) as in `Bubbles`.
    propose : for k bubbles (their numbers) and m places of each: candidates (k, m, 3) from wherever
        they may be.
    what : named in errors.

    Raises InputError: no place was found for some of them.
    """
    count = len(semi_axes_mm)
    order = np.argsort(-semi_axes_mm.max(axis=1), kind="stable")
    shapes = shapes_of(semi_axes_mm, rotation)
    bodies = shapes, semi_axes_mm.max(axis=1), semi_axes_mm.min(axis=1)
    width = float(semi_axes_mm.max(initial=1e-9)) * 2.0
    centers = np.full((count, 3), np.nan)
    left = order
    for _ in range(_ROUNDS):
        if not len(left):
            return centers
        tried = propose(left, _TRIES)
        cells, low = _grid(centers, tried, width)
        left = left[~_place(left, tried, centers, bodies, (cells, low, width))]
    raise InputError(
        f"{what}: expected room for {count} bubbles, but for {len(left)} of them none was found: "
        "ask for fewer, smaller ones or overlap"
    )


@numba.njit(cache=True, error_model="numpy")
def _place(left: Any, tried: Any, centers: Any, bodies: Any, grid: Any) -> Any:
    """Put each bubble at the first of its candidates where it fits.

    Bodies are shapes, largest and smallest semi-axes, the grid is that of `_grid`. Returns which
    bubbles were placed.
    """
    heads = np.full(grid[0].prod(), -1, dtype=np.int64)
    chain = np.full(len(centers), -1, dtype=np.int64)
    for n in range(len(centers)):
        if not np.isnan(centers[n, 0]):
            _enter(n, centers[n], heads, chain, grid)
    placed = np.zeros(len(left), dtype=np.bool_)
    for k in range(len(left)):
        n = left[k]
        for m in range(tried.shape[1]):
            if _fits(n, tried[k, m], centers, bodies, heads, chain, grid):
                for axis in range(3):
                    centers[n, axis] = tried[k, m, axis]
                _enter(n, centers[n], heads, chain, grid)
                placed[k] = True
                break
    return placed


@inner_kernel(error_model="numpy")
def _cell(point: Any, axis: int, grid: Any) -> Any:
    cells, low, width = grid
    return min(max(int((point[axis] - low[axis]) / width), 0), cells[axis] - 1)


@inner_kernel(error_model="numpy")
def _enter(n: int, point: Any, heads: Any, chain: Any, grid: Any) -> None:
    i, j, k = _cell(point, 0, grid), _cell(point, 1, grid), _cell(point, 2, grid)
    where = (k * grid[0][1] + j) * grid[0][0] + i
    chain[n] = heads[where]
    heads[where] = n


@inner_kernel(error_model="numpy")
def _fits(n: int, point: Any, centers: Any, bodies: Any, heads: Any, chain: Any, grid: Any) -> bool:
    (shapes, largest, smallest), cells = bodies, grid[0]
    i, j, k = _cell(point, 0, grid), _cell(point, 1, grid), _cell(point, 2, grid)
    for z in range(max(k - 1, 0), min(k + 2, cells[2])):
        for y in range(max(j - 1, 0), min(j + 2, cells[1])):
            for x in range(max(i - 1, 0), min(i + 2, cells[0])):
                other = heads[(z * cells[1] + y) * cells[0] + x]
                while other >= 0:
                    square = 0.0
                    for axis in range(3):
                        square += (centers[other, axis] - point[axis]) ** 2
                    if square < (largest[n] + largest[other]) ** 2 and (
                        square < (smallest[n] + smallest[other]) ** 2
                        or contact_factor(point, shapes[n], centers[other], shapes[other]) < 1.0
                    ):
                        return False
                    other = chain[other]
    return True


def _grid(centers: F64, tried: F64, width: float) -> tuple[I64, F64]:
    """Make a grid of cells for all candidates. Counts along x, y, z, and origin."""
    points = np.concatenate([centers[np.isfinite(centers[:, 0])], tried.reshape(-1, 3)])
    low = points.min(axis=0)
    cells = np.maximum(1, np.ceil((points.max(axis=0) - low) / width + 1e-9)).astype(np.int64)
    return cells, low
