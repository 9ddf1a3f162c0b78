"""Corrections of voxels by recorded and projected light: jointly, or by pixels.

Every step corrects the values in place and returns the squared norm of the residual P - W I before
the correction.

In the sweep of MART every pixel corrects the voxels on its line of sight, after the corrections by
the pixels before it. For one camera at a time the voxels are sorted by the first pixel of their
footprints. A pixel then finds its voxels in a few stretches of memory, one for every row that its
footprints can begin in, and W is never stored. Strips of pixels that share no voxel are
independent: all even strips are processed first, then all odd ones, and in each strip the pixels
row by row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sabench.algorithms.tomography.kernels import STEPS, exp2, locate, multiply, scratch
from sabench.algorithms.tomography.projection_operator import TASKS, ProjectionOperator
from sabench.utils.arrays import F32, I64, Bool
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores

# rows of pixels, more than a footprint has: every other strip shares no voxel with this one
STRIP = 16


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
    parts = support.parts(TASKS)
    # sorted by counting, stable and in parallel
    slots = np.zeros((TASKS, geometry.rows * geometry.columns), dtype=np.int32)
    first = np.empty(geometry.rows * geometry.columns + 1, dtype=np.int64)
    voxels = parts, support.start, support.x
    on_cores(_count, TASKS, geometry, camera, voxels, slots)
    _number(slots, first)
    entries = int(first[-1])
    voxel = np.empty(entries, dtype=np.int32)
    across, down, light = (np.empty(entries, dtype=np.float32) for _ in range(3))
    spread, taps = np.float32(lines.footprint.spread), 2 + 2 * geometry.margin
    buckets = Buckets(spread, taps, geometry.columns, first, voxel, across, down, light)
    on_cores(_fill, TASKS, geometry, camera, voxels, values, slots, buckets)
    missed = np.zeros(math.ceil(len(image) / STRIP))
    for odd in range(2):
        strips = (len(missed) - odd + 1) // 2
        on_cores(_sweep, strips, odd, buckets, image, saturated, np.float32(relaxation), missed)
    on_cores(_put_back, entries, buckets.voxel, buckets.light, values)
    return float(missed.sum())


@numba.njit(cache=True, nogil=True)
def _count(jobs: slice, geometry: Any, camera: int, voxels: Any, slots: Any) -> None:
    """Count the voxels of every part on every pixel into zero slots (part, pixel)."""
    parts, start, x = voxels
    for part in range(jobs.start, jobs.stop):
        work, corner = scratch(geometry), geometry.margin * (geometry.columns + 1)
        for row in range(parts[part], parts[part + 1]):
            base, _, _ = locate(geometry, camera, row, x[start[row] : start[row + 1]], work)
            for i in range(len(base)):
                if base[i] >= 0:
                    slots[part, base[i] - corner] += 1


@numba.njit(cache=True)
def _number(slots: Any, first: Any) -> None:
    """Turn counts into the places of every part's first voxel in every pixel."""
    first[:] = 0
    for part in range(len(slots)):  # along memory
        for pixel in range(slots.shape[1]):
            first[pixel + 1] += slots[part, pixel]
    for pixel in range(slots.shape[1]):
        first[pixel + 1] += first[pixel]
    place = first[:-1].copy()
    for part in range(len(slots)):
        for pixel in range(slots.shape[1]):
            count = slots[part, pixel]
            slots[part, pixel] = place[pixel]
            place[pixel] += count


@numba.njit(cache=True, nogil=True)
def _fill(
    jobs: slice, geometry: Any, camera: int, voxels: Any, values: Any, slots: Any, buckets: Any
) -> None:
    """Put every part's voxels into their pixels; `slots` advances with each."""
    parts, start, x = voxels
    for part in range(jobs.start, jobs.stop):
        work, corner = scratch(geometry), geometry.margin * (geometry.columns + 1)
        for row in range(parts[part], parts[part + 1]):
            base, across, down = locate(geometry, camera, row, x[start[row] : start[row + 1]], work)
            for i in range(len(base)):
                if base[i] >= 0:
                    slot = slots[part, base[i] - corner]
                    slots[part, base[i] - corner] += 1
                    right, below = np.float32(across[i]), np.float32(down[i])
                    column, line = base[i] % geometry.columns, base[i] // geometry.columns
                    buckets.voxel[slot] = start[row] + i
                    buckets.across[slot] = np.float32(column) + right / np.float32(STEPS)
                    buckets.down[slot] = np.float32(line) + below / np.float32(STEPS)
                    buckets.light[slot] = values[start[row] + i]


@numba.njit(cache=True, nogil=True)
def _put_back(jobs: slice, voxel: Any, light: Any, values: Any) -> None:
    for k in range(jobs.start, jobs.stop):
        values[voxel[k]] = light[k]


@numba.njit(cache=True, nogil=True)
def _sweep(
    jobs: slice, odd: int, buckets: Any, image: Any, saturated: Any, relaxation: Any, missed: Any
) -> None:
    """Update by every other strip; sum squared residuals into `missed` (strip,)."""
    for pair in range(jobs.start, jobs.stop):
        strip = 2 * pair + odd
        missed[strip] = _sweep_strip(buckets, image, saturated, relaxation, strip)


@inner_kernel()
def _sweep_strip(buckets: Any, image: Any, saturated: Any, relaxation: Any, strip: int) -> float:
    total = 0.0
    for row in range(strip * STRIP, min((strip + 1) * STRIP, len(image))):
        for column in range(image.shape[1]):
            total += _correct(
                buckets, row, column, image[row, column], saturated[row, column], relaxation
            )
    return total


@inner_kernel()
def _correct(
    buckets: Any, row: int, column: int, light: Any, saturated: Any, relaxation: Any
) -> Any:
    """Correct the voxels of one pixel and return its squared residual."""
    projected = _line_of_sight(buckets, row, column)
    if saturated and projected >= light:
        return np.float32(0.0)
    if projected > 0.0:
        _raise(buckets, row, column, relaxation * np.float32(math.log2(light / projected)))
    return (light - projected) ** 2


@inner_kernel()
def _line_of_sight(buckets: Any, row: int, column: int) -> Any:
    """Compute sum_j W_ij I_j of one pixel."""
    total = np.float32(0.0)
    for above in range(min(buckets.taps, row + 1)):
        voxels = _stretch(buckets, row - above, column)
        total += _sum(*voxels, np.float32(row), np.float32(column), buckets.spread)
    return total


@inner_kernel()
def _raise(buckets: Any, row: int, column: int, exponent: Any) -> None:
    """Multiply the voxels of one pixel: I_j <- I_j 2^(exponent W_ij)."""
    for above in range(min(buckets.taps, row + 1)):
        voxels = _stretch(buckets, row - above, column)
        _multiply(*voxels, np.float32(row), np.float32(column), buckets.spread, exponent)


@inner_kernel()
def _stretch(buckets: Any, row: int, column: int) -> Any:
    """List rows, columns and light of the voxels with footprints that reach a pixel."""
    left, line = max(column - buckets.taps + 1, 0), row * buckets.columns
    here = slice(buckets.first[line + left], buckets.first[line + column + 1])
    return buckets.down[here], buckets.across[here], buckets.light[here]


@inner_kernel(fastmath=True)
def _sum(down: Any, across: Any, light: Any, row: Any, column: Any, spread: Any) -> Any:
    total = np.float32(0.0)
    for k in range(len(light)):
        total += _share(down[k] - row, spread) * _share(across[k] - column, spread) * light[k]
    return total


@inner_kernel(fastmath=True)
def _multiply(
    down: Any, across: Any, light: Any, row: Any, column: Any, spread: Any, exponent: Any
) -> None:
    for k in range(len(light)):
        part = exponent * _share(down[k] - row, spread)
        light[k] *= exp2(part * _share(across[k] - column, spread))


@inner_kernel(fastmath=True)
def _share(distance: Any, spread: Any) -> Any:
    """Compute a pixel's part of a voxel's light along one axis; see `Footprint`."""
    one, none = np.float32(1.0), np.float32(0.0)
    direct = max(one - abs(distance), none)
    given = max(one - abs(distance - one), none) + max(one - abs(distance + one), none)
    return direct + spread * (given - direct - direct)


# of a bright particle's peak: darker pixels are raised to it, since the logarithm of zero is no
# correction
DARKEST = 1e-3
_NOTHING = np.float32(1e-30)  # the least light of projections, and of what pixels may have seen


@dataclass(frozen=True)
class Iterate:
    """An iteration's voxels.

    Attributes
    ----------
    lines : W on their support.
    values : (n,) light of the voxels; steps change it in place.
    seen : (n,) sum_i W_ij over the pixels that are known, the number of cameras that see each
        voxel; 1 where it is less. The value is 0 where no camera sees the voxel.
    """

    lines: ProjectionOperator
    values: F32
    seen: F32


@dataclass(frozen=True)
class RecordedLight:
    """Light recorded by the cameras.

    Attributes
    ----------
    light : (camera, row, column) P, at least DARKEST, but less in pixels that show nothing.
    saturated : (camera, row, column) pixels that may have received more light than they show: where
        the projection is brighter, the residual is zero.
    """

    light: F32
    saturated: Bool

    @classmethod
    def of(cls, light: F32, saturated: Bool, unknown: Bool) -> RecordedLight:
        """Make it of normalised images; every projection explains the unknown pixels."""
        filled = np.where(unknown, _NOTHING, np.maximum(light, np.float32(DARKEST)))
        return cls(filled, saturated | unknown)

    def unknown(self) -> Bool:
        """Mark the pixels (camera, row, column) that show nothing."""
        return np.asarray(self.light < DARKEST)

    def possible(self) -> F32:
        """Give the light (camera, row, column); a bright particle's where it is unknown."""
        return np.where(self.unknown(), np.float32(1.0), self.light)

    def missing(self, projection: F32) -> float:
        """Turn a projection W I into P - W I, in place; returns the sum of squares."""
        return self._compare(projection, _missing)

    def log_ratio(self, projection: F32) -> float:
        """Turn W I into log2(P / W I), in place; returns the sum of squares of P - W I."""
        return self._compare(projection, _log_ratio)

    def _compare(self, projection: F32, kernel: Callable[..., None]) -> float:
        rows = projection.shape[0] * projection.shape[1]
        squares = np.empty(rows)
        arrays = self.light, self.saturated, projection
        on_cores(kernel, rows, *(array.reshape(rows, -1) for array in arrays), squares)
        return float(squares.sum())


@numba.njit(cache=True, nogil=True)
def _missing(jobs: slice, light: Any, saturated: Any, projection: Any, squares: Any) -> None:
    for row in range(jobs.start, jobs.stop):
        total = 0.0
        for i in range(light.shape[1]):
            missing = light[row, i] - projection[row, i]
            if saturated[row, i]:
                missing = max(missing, np.float32(0.0))
            projection[row, i] = missing
            total += missing**2
        squares[row] = total


@numba.njit(cache=True, nogil=True)
def _log_ratio(jobs: slice, light: Any, saturated: Any, projection: Any, squares: Any) -> None:
    for row in range(jobs.start, jobs.stop):
        total = 0.0
        for i in range(light.shape[1]):
            cast = max(projection[row, i], _NOTHING)
            if saturated[row, i]:
                cast = min(cast, light[row, i])
            projection[row, i] = np.log2(light[row, i] / cast)
            total += (light[row, i] - cast) ** 2
        squares[row] = total


def smart(state: Iterate, measured: RecordedLight, relaxation: float) -> float:
    """Iterate I_j <- I_j prod_i (P_i / (W I)_i)^(mu W_ij / N_j).

    All pixels are used simultaneously, in the geometric mean over the N_j = seen_j cameras.

    Source: simultaneous MART, Mishra et al. (1999); Atkinson and Soria (2009).
    """
    images = state.lines.forward(state.values)
    missed = measured.log_ratio(images)
    exponents = state.lines.adjoint(images)
    exponents /= state.seen
    on_cores(multiply, len(exponents), state.values, exponents, np.float32(relaxation))
    return missed


def sart(state: Iterate, measured: RecordedLight, lengths: F32, relaxation: float) -> float:
    """Update I_j <- max(0, I_j + mu sum_i W_ij (P_i - (W I)_i) / L_i / N_j).

    L_i = sum_j W_ij = lengths_i and N_j = sum_i W_ij = seen_j.

    Source: simultaneous algebraic reconstruction, Andersen and Kak (1984); Atkinson and Soria
    (2009).
    """
    images = state.lines.forward(state.values)
    missed = measured.missing(images)
    correction = state.lines.adjoint(np.divide(images, lengths, out=images, where=lengths > 0.0))
    correction *= np.float32(relaxation) / state.seen
    state.values[:] += correction
    np.maximum(state.values, np.float32(0.0), out=state.values)
    return missed


def block_mart(state: Iterate, measured: RecordedLight, relaxation: float) -> float:
    """Update by one camera after the other, all its pixels simultaneously.

    I_j <- I_j prod_i (P_i / (W I)_i)^(mu W_ij).

    Source: block-iterative MART, Byrne (1998), with a camera's pixels as the block.
    """
    missed = 0.0
    for camera in state.lines.cameras:
        image = state.lines.forward(state.values, [camera])
        part = slice(camera, camera + 1)
        recorded = RecordedLight(measured.light[part], measured.saturated[part])
        missed += recorded.log_ratio(image)
        exponents = state.lines.adjoint(image, [camera])
        on_cores(multiply, len(exponents), state.values, exponents, np.float32(relaxation))
    return missed


def mart(state: Iterate, measured: RecordedLight, relaxation: float) -> float:
    """Update by one camera after the other, pixel by pixel: see `mart_sweep`."""
    missed = 0.0
    for camera, image in enumerate(zip(measured.light, measured.saturated, strict=True)):
        missed += mart_sweep(state.lines, state.values, camera, *image, relaxation)
    return missed


def iterate(
    step: Callable[[], float],
    measured: RecordedLight,
    iterations: int,
    tolerance: float,
    doing: str,
) -> Iterator[float]:
    """Repeat a step, and yield the relative residual ||P - W I|| / ||P|| after each.

    Ends before `iterations` when the residual has changed by less than a fraction `tolerance` of
    its last value.
    """
    scale, before = float(np.vdot(measured.light, measured.light)), float("inf")
    for _ in progress_bar(range(iterations), doing):
        residual = float(np.sqrt(step() / scale))
        yield residual
        if abs(before - residual) < tolerance * before:
            break
        before = residual
