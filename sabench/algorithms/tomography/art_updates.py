"""Corrections of the voxels by comparing recorded and projected light.

Every step corrects the values in place and returns the squared norm of the residual P - W I before
the correction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.tomography.kernels import multiply
from sabench.algorithms.tomography.mart_sweep import mart_sweep
from sabench.algorithms.tomography.projection_operator import ProjectionOperator
from sabench.utils.arrays import F32, Bool
from sabench.utils.compiled import numba
from sabench.utils.progress import progress_bar

# of a bright particle's peak: darker pixels are raised to it, since the logarithm of zero is no
# correction
DARKEST = 1e-3
_NOTHING = 1e-30
_UNKNOWN = np.float32(1e-30)  # at least as much light: no projection is too bright for it


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
        known = np.where(unknown, _UNKNOWN, np.maximum(light, np.float32(DARKEST)))
        return cls(known, saturated | unknown)

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
        kernel(*(array.reshape(rows, -1) for array in arrays), squares)
        return float(squares.sum())


@numba.njit(cache=True, parallel=True)
def _missing(light: Any, saturated: Any, projection: Any, squares: Any) -> None:
    for row in numba.prange(len(light)):
        total = 0.0
        for i in range(light.shape[1]):
            missing = light[row, i] - projection[row, i]
            if saturated[row, i]:
                missing = max(missing, np.float32(0.0))
            projection[row, i] = missing
            total += missing**2
        squares[row] = total


@numba.njit(cache=True, parallel=True)
def _log_ratio(light: Any, saturated: Any, projection: Any, squares: Any) -> None:
    for row in numba.prange(len(light)):
        total = 0.0
        for i in range(light.shape[1]):
            cast = max(projection[row, i], np.float32(_NOTHING))
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
    multiply(state.values, exponents, np.float32(relaxation))
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
        own = RecordedLight(measured.light[part], measured.saturated[part])
        missed += own.log_ratio(image)
        multiply(state.values, state.lines.adjoint(image, [camera]), np.float32(relaxation))
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
