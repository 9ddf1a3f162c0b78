"""Peaks of images and their neighbours."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from sabench.utils.arrays import F32, F64, I64

_CELL_PX = 4.0


class Spots(NamedTuple):
    """One camera's particle images, sorted into square cells.

    Attributes
    ----------
    pixel : (n, 2).
    start : (cells + 1,) where each cell's images begin.
    across, down : cells.
    """

    pixel: F64
    start: I64
    across: int
    down: int


def spots_of(light: F32, least: float) -> Spots:
    """Local maxima above `least` of an image (rows, columns), to parts of a pixel by Gaussians through three values along either axis."""
    row, column = _maxima(np.ascontiguousarray(light), np.float32(least))
    height = np.log(np.maximum(light, np.float32(1e-6 + 0.01 * least)))
    across = _vertex(height[row, column - 1], height[row, column], height[row, column + 1])
    along = _vertex(height[row - 1, column], height[row, column], height[row + 1, column])
    return _sorted(np.column_stack([column + across, row + along]).astype(np.float64), light.shape)


@numba.njit(cache=True)
def _maxima(light: Any, least: Any) -> Any:
    """Rows and columns of pixels that no neighbour outshines, borders left out."""
    rows, columns = light.shape
    found = []
    for r in range(1, rows - 1):
        for c in range(1, columns - 1):
            value = light[r, c]
            if value < least:
                continue
            top = True
            for i in range(-1, 2):
                for j in range(-1, 2):
                    other = light[r + i, c + j]
                    if other > value or (other == value and (i < 0 or (i == 0 and j < 0))):
                        top = False
            if top:
                found.append((r, c))
    out = np.empty((2, len(found)), dtype=np.int64)
    for n in range(len(found)):
        out[0, n], out[1, n] = found[n]
    return out


def _vertex(before: F32, here: F32, behind: F32) -> F64:
    bend = 2.0 * (before - 2.0 * here + behind).astype(np.float64)
    return np.clip((before - behind) / np.where(bend < -1e-6, bend, -np.inf), -0.5, 0.5)


def _sorted(pixel: F64, shape: tuple[int, ...]) -> Spots:
    down, across = (math.ceil(size / _CELL_PX) for size in shape)
    cell = (pixel[:, 1] // _CELL_PX).astype(np.int64) * across + (pixel[:, 0] // _CELL_PX).astype(
        np.int64
    )
    order = np.argsort(cell, kind="stable")
    return Spots(
        np.ascontiguousarray(pixel[order]),
        np.searchsorted(cell[order], np.arange(across * down + 1)).astype(np.int64),
        across,
        down,
    )


@numba.njit(cache=True)
def around(spots: Any, pixel: Any, reach: float, found: Any) -> int:
    """Numbers of the particle images within reach of a pixel; returns how many."""
    count = 0
    left, right = (
        max(int((pixel[0] - reach) // _CELL_PX), 0),
        min(int((pixel[0] + reach) // _CELL_PX), spots.across - 1),
    )
    top, bottom = (
        max(int((pixel[1] - reach) // _CELL_PX), 0),
        min(int((pixel[1] + reach) // _CELL_PX), spots.down - 1),
    )
    for r in range(top, bottom + 1):
        for c in range(left, right + 1):
            for n in range(
                spots.start[r * spots.across + c], spots.start[r * spots.across + c + 1]
            ):
                if math.hypot(
                    spots.pixel[n, 0] - pixel[0], spots.pixel[n, 1] - pixel[1]
                ) <= reach and count < len(found):
                    found[count] = n
                    count += 1
    return count
