"""Errors of velocities and accelerations of particles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.utils.arrays import F64, I64


def accelerations(frames: Sequence[tuple[I64, F64]], duration: float) -> tuple[I64, F64]:
    """Compute second differences of three frames' positions over duration squared.

    Parameters
    ----------
    frames : numbers (n,) and positions (n, 3) in each of the three, n differs.
    duration : between two frames; equal for both pairs.

    Returns
    -------
    Rows (k,) of the middle frame whose numbers are in all three, and accelerations (k, 3).
    """
    (first, before), (middle, now), (last, after) = frames
    _, i, j = np.intersect1d(first, middle, return_indices=True)
    _, k, m = np.intersect1d(middle[j], last, return_indices=True)
    rows = j[k]
    return rows, (before[i[k]] - 2.0 * now[rows] + after[m]) / duration**2


def claimed_errors(pairs: Sequence[tuple[F64, F64]]) -> tuple[F64, F64]:
    """Compute the lengths of the errors of all vectors (n, 3), and true lengths."""
    none = np.zeros((0, 3))
    estimate = np.concatenate([none, *(one for one, _ in pairs)])
    true = np.concatenate([none, *(other for _, other in pairs)])
    return np.linalg.norm(estimate - true, axis=1), np.linalg.norm(true, axis=1)


def median_errors(off: F64, size: F64) -> tuple[float, float]:
    """Compute the median error, and the median error over the true size in percent.

    The latter is of what is not zero; NaN without any.
    """
    some = size > 0.0
    return _median(off), 100.0 * _median(off[some] / size[some])


def _median(values: F64) -> float:
    return float(np.median(values)) if len(values) else float("nan")
