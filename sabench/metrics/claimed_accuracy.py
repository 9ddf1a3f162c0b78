"""Errors of positions against what images allow and estimates claim."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincinv

from sabench.utils.arrays import F64, Bool


def squared_distance(error: F64, covariance: F64) -> F64:
    """Compute squared Mahalanobis distances (n,) of errors (n, 3)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    distance: F64 = np.einsum("na,na->n", error, solved)
    return distance


def rms_over_bound(error: F64, bound: F64) -> float:
    """Compute the root mean square of errors (n, 3) over bounds (n, 3, 3).

    It is 1 at the bound. Errors of particles without a bound (NaN) are left out; NaN without
    others.
    """
    known = np.isfinite(bound).all(axis=(1, 2))
    if not known.any():
        return math.nan
    return math.sqrt(float(squared_distance(error[known], bound[known]).mean()) / 3.0)


def coverage(error: F64, covariance: F64, nominal: float) -> float:
    """Compute the share of errors (n, 3) that claimed ellipsoids hold, over nominal.

    Covariances (n, 3, 3) are those of a normal distribution. NaN without errors.
    """
    if not len(error):
        return math.nan
    limit = 2.0 * float(gammaincinv(1.5, nominal))  # quantile of chi square, three degrees
    return float((squared_distance(error, covariance) <= limit).mean()) / nominal


def brier_score(probability: F64, true: Bool) -> float:
    """Compute the mean square of probabilities (n,) less what is true.

    NaN without any.

    Source: G. W. Brier, Monthly Weather Review 78 (1950) 1.
    """
    return float(np.square(probability - true).mean()) if len(true) else math.nan
