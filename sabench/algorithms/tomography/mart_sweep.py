"""MART pixel by pixel.

Every pixel corrects the voxels on its line of sight, after the corrections by the pixels before it.

For one camera at a time the voxels are sorted by the first pixel of their footprints. A pixel then
finds its voxels in a few stretches of memory, one for every row that its footprints can begin in,
and W is never stored. Strips of pixels that share no voxel are independent: all even strips are
processed first, then all odd ones, and in each strip the pixels row by row.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sabench.algorithms.tomography.kernels import STEPS, exp2, locate, scratch
from sabench.algorithms.tomography.projection_operator import ProjectionOperator
from sabench.utils.arrays import F32, I64, Bool
from sabench.utils.compiled import numba

# rows of pixels, more than a footprint has: every other strip shares no voxel with this one
STRIP = 16
# of the volume, sorted by themselves; a fixed number, so that the order does not depend on how many
# threads there are
_PARTS = 16


class Buckets(NamedTuple):
    """Voxels sorted by the upper left pixel of their footprints.

    Attributes
    ----------
    spread, taps : of a footprint, and its pixels along either axis.
    columns : pixels of a row.
    first : (rows * columns + 1,) where each pixel's voxels begin.
    voxel : (n,) their numbers in the support.
    across, down : (n,) float32 column and row.
    light : (n,) light of the voxels.
    """

    spread: np.float32
    taps: int
    columns: int
    first: I64
    voxel: npt.NDArray[np.int32]
    across: F32
    down: F32
    light: F32


def mart_sweep(
    lines: ProjectionOperator,
    values: F32,
    camera: int,
    image: F32,
    saturated: Bool,
    relaxation: float,
) -> float:
    """Correct the voxels (n,) in place by all pixels of one camera.

    Returns the sum of the squares of the pixels' residuals.

    Parameters
    ----------
    image : (row, column) P, greater than zero.
    saturated : (row, column) pixels that only correct voxels that are too dark.
    relaxation : mu.

    Source: thesis, equation 3.9: I_j <- I_j (P_i / sum_j W_ij I_j)^(mu W_ij) for one pixel i after
    the other.
    """
    geometry, support = lines.geometry, lines.support
    parts = support.parts(_PARTS)
    # sorted by counting, stable and in parallel
    slots = np.zeros((_PARTS, geometry.rows * geometry.columns), dtype=np.int32)
    first = np.empty(geometry.rows * geometry.columns + 1, dtype=np.int64)
    _count(geometry, camera, parts, support.start, support.x, slots)
    _number(slots, first)
    seen = int(first[-1])
    voxel = np.empty(seen, dtype=np.int32)
    across, down, light = (np.empty(seen, dtype=np.float32) for _ in range(3))
    spread, taps = np.float32(lines.footprint.spread), 2 + 2 * geometry.margin
    buckets = Buckets(spread, taps, geometry.columns, first, voxel, across, down, light)
    _fill(geometry, camera, parts, support.start, support.x, values, slots, buckets)
    missed = np.zeros(math.ceil(len(image) / STRIP))
    _sweep(buckets, image, saturated, np.float32(relaxation), missed)
    _put_back(buckets.voxel, buckets.light, values)
    return float(missed.sum())


@numba.njit(cache=True, parallel=True)
def _count(geometry: Any, camera: int, parts: Any, start: Any, x: Any, slots: Any) -> None:
    """Count the voxels of every part on every pixel into zero slots (part, pixel)."""
    for part in numba.prange(len(parts) - 1):
        work, corner = scratch(geometry), geometry.margin * (geometry.columns + 1)
        for row in range(parts[part], parts[part + 1]):
            base, _, _ = locate(geometry, camera, row, x[start[row] : start[row + 1]], work)
            for i in range(len(base)):
                if base[i] >= 0:
                    slots[part, base[i] - corner] += 1


@numba.njit(cache=True)
def _number(slots: Any, first: Any) -> None:
    """Turn counts into the places of every part's first voxel in every pixel."""
    total = 0
    for pixel in range(slots.shape[1]):
        first[pixel] = total
        for part in range(len(slots)):
            count = slots[part, pixel]
            slots[part, pixel] = total
            total += count
    first[-1] = total


@numba.njit(cache=True, parallel=True)
def _fill(
    geometry: Any,
    camera: int,
    parts: Any,
    start: Any,
    x: Any,
    values: Any,
    slots: Any,
    buckets: Any,
) -> None:
    for part in numba.prange(len(parts) - 1):
        _fill_part(
            geometry, camera, parts[part], parts[part + 1], start, x, values, slots[part], buckets
        )


@numba.njit(cache=True)
def _fill_part(
    geometry: Any,
    camera: int,
    begin: int,
    end: int,
    start: Any,
    x: Any,
    values: Any,
    slots: Any,
    buckets: Any,
) -> None:
    """Put the voxels of some rows into their pixels; `slots` advances with each."""
    work, corner = scratch(geometry), geometry.margin * (geometry.columns + 1)
    for row in range(begin, end):
        base, across, down = locate(geometry, camera, row, x[start[row] : start[row + 1]], work)
        for i in range(len(base)):
            if base[i] >= 0:
                slot = slots[base[i] - corner]
                slots[base[i] - corner] += 1
                buckets.voxel[slot] = start[row] + i
                buckets.across[slot] = np.float32(base[i] % geometry.columns) + np.float32(
                    across[i]
                ) / np.float32(STEPS)
                buckets.down[slot] = np.float32(base[i] // geometry.columns) + np.float32(
                    down[i]
                ) / np.float32(STEPS)
                buckets.light[slot] = values[start[row] + i]


@numba.njit(cache=True, parallel=True)
def _put_back(voxel: Any, light: Any, values: Any) -> None:
    for k in numba.prange(len(voxel)):
        values[voxel[k]] = light[k]


@numba.njit(cache=True, parallel=True)
def _sweep(buckets: Any, image: Any, saturated: Any, relaxation: Any, missed: Any) -> None:
    """Update by all pixels of one camera; sum squared residuals into `missed`.

    `missed` has the shape (strip,).
    """
    for parity in range(2):
        for pair in numba.prange((len(missed) - parity + 1) // 2):
            missed[2 * pair + parity] = _sweep_strip(
                buckets, image, saturated, relaxation, 2 * pair + parity
            )


@numba.njit(cache=True)
def _sweep_strip(buckets: Any, image: Any, saturated: Any, relaxation: Any, strip: int) -> float:
    total = 0.0
    for row in range(strip * STRIP, min((strip + 1) * STRIP, len(image))):
        for column in range(image.shape[1]):
            total += _correct(
                buckets, row, column, image[row, column], saturated[row, column], relaxation
            )
    return total


@numba.njit(cache=True)
def _correct(
    buckets: Any, row: int, column: int, light: Any, saturated: Any, relaxation: Any
) -> Any:
    """Correct the voxels of one pixel and return its squared residual."""
    seen = _line_of_sight(buckets, row, column)
    if saturated and seen >= light:
        return np.float32(0.0)
    if seen > 0.0:
        _raise(buckets, row, column, relaxation * np.float32(math.log2(light / seen)))
    return (light - seen) ** 2


@numba.njit(cache=True)
def _line_of_sight(buckets: Any, row: int, column: int) -> Any:
    """Compute sum_j W_ij I_j of one pixel."""
    total = np.float32(0.0)
    for above in range(min(buckets.taps, row + 1)):
        total += _sum(
            *_stretch(buckets, row - above, column),
            np.float32(row),
            np.float32(column),
            buckets.spread,
        )
    return total


@numba.njit(cache=True)
def _raise(buckets: Any, row: int, column: int, exponent: Any) -> None:
    """Multiply the voxels of one pixel: I_j <- I_j 2^(exponent W_ij)."""
    for above in range(min(buckets.taps, row + 1)):
        _multiply(
            *_stretch(buckets, row - above, column),
            np.float32(row),
            np.float32(column),
            buckets.spread,
            exponent,
        )


@numba.njit(cache=True)
def _stretch(buckets: Any, row: int, column: int) -> Any:
    """List rows, columns and light of the voxels whose footprints reach a pixel."""
    left, line = max(column - buckets.taps + 1, 0), row * buckets.columns
    here = slice(buckets.first[line + left], buckets.first[line + column + 1])
    return buckets.down[here], buckets.across[here], buckets.light[here]


@numba.njit(cache=True, fastmath=True)
def _sum(down: Any, across: Any, light: Any, row: Any, column: Any, spread: Any) -> Any:
    total = np.float32(0.0)
    for k in range(len(light)):
        total += _share(down[k] - row, spread) * _share(across[k] - column, spread) * light[k]
    return total


@numba.njit(cache=True, fastmath=True)
def _multiply(
    down: Any, across: Any, light: Any, row: Any, column: Any, spread: Any, exponent: Any
) -> None:
    for k in range(len(light)):
        light[k] *= exp2(
            exponent * _share(down[k] - row, spread) * _share(across[k] - column, spread)
        )


@numba.njit(cache=True, fastmath=True)
def _share(distance: Any, spread: Any) -> Any:
    """Compute the part of a voxel's light a pixel gets along one axis.

    See `Footprint`.
    """
    one, none = np.float32(1.0), np.float32(0.0)
    own = max(one - abs(distance), none)
    given = max(one - abs(distance - one), none) + max(one - abs(distance + one), none)
    return own + spread * (given - own - own)
