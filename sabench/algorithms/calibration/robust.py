"""Bundle adjustment with detection of outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import (
    BoardImages,
    Fit,
    Moving,
    refine,
    residuals,
)
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.utils.arrays import F64, Bool

_NOTHING_ODD = 6.0  # standard deviations that no error of honest points exceeds: 3e-8 of them do
_REJECT = 4.0  # standard deviations beyond which a point counts as an outlier
_ROUNDS = 10
_RAYLEIGH_MEDIAN = 1.17741  # median length of a pair of standard normal numbers
_CAUCHY = 2.4  # standard deviations at which Cauchy's loss bends

Held = Literal["richer model", "initial guess"]


@dataclass(frozen=True)
class Robust:
    """Fit, the observations (camera, board, point) used, and their noise in px.

    The noise is that of one coordinate. `held` says where the depth of the boards had to be
    held, if it had to be.
    """

    fit: Fit
    used: Bool
    noise_px: float
    held: Held | None = None


def adjust(
    state: State,
    seen: BoardImages,
    free: FreeParameters,
    *,
    noise_px: float | None = None,
    moving: Moving = "all",
) -> Robust:
    """Fit by least squares, robustly if errors exceed normal noise.

    The robust fit uses Cauchy's loss, then rejects outliers, then uses least squares again.

    Parameters
    ----------
    noise_px : of the pixel coordinates, if it is known; by default it is estimated from the median
        error.
    moving : what is adjusted, as for `refine`.
    """
    start = np.asarray(seen.weights > 0.0)
    fit, used = refine(state, seen, free, moving=moving), start
    noise = noise_px or _noise(_lengths(fit.state, seen), used)
    if _lengths(fit.state, seen)[used].max(initial=0.0) <= _NOTHING_ODD * max(noise, 1e-9):
        return Robust(fit, used, noise)
    fit = _fit_cauchy(fit.state, seen, free, moving)
    for _ in range(_ROUNDS):
        lengths = _lengths(fit.state, seen)
        noise = _noise(lengths, used)
        kept = start & (lengths <= _REJECT * max(noise, 1e-9))
        if np.array_equal(kept, used):
            break
        used = kept
        kept_only = replace(seen, weights=np.where(used, seen.weights, 0.0))
        fit = refine(fit.state, kept_only, free, moving=moving)
    return Robust(fit, used, noise)


def _fit_cauchy(state: State, seen: BoardImages, free: FreeParameters, moving: Moving) -> Fit:
    """Fit with Cauchy's loss, whose scale follows the errors down."""
    used = np.asarray(seen.weights > 0.0)
    scale = np.inf
    for _ in range(_ROUNDS):
        smaller = _CAUCHY * max(_noise(_lengths(state, seen), used), 1e-6)
        if smaller > 0.9 * scale:
            break
        scale = smaller
        fit = refine(state, seen, free, scale, moving=moving)
        state = fit.state
    return fit


def _lengths(state: State, seen: BoardImages) -> F64:
    """Compute reprojection errors (camera, board, point) in px.

    Infinite where there is none.
    """
    lengths = np.linalg.norm(residuals(state, seen), axis=-1)
    return np.where(np.isfinite(lengths), lengths, np.inf)


def median_noise(lengths: F64) -> float:
    """Compute the noise of coordinates whose pairs have this median length.

    The noise is the standard deviation of normal coordinates.
    """
    return float(np.median(lengths)) / _RAYLEIGH_MEDIAN


def _noise(lengths: F64, used: Bool) -> float:
    """Compute the standard deviation per coordinate that explains the median error."""
    return median_noise(lengths[used])
