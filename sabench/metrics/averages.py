"""Averages of figures; some figures may be missing."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from sabench.utils.arrays import F64


def finite_or_none(value: float) -> float | None:
    """Return a finite value, None instead of NaN and infinity."""
    return float(value) if np.isfinite(value) else None


def mean_of_finite(values: Iterable[float | None]) -> float | None:
    """Average the finite values; None without any."""
    finite = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(finite)) if finite else None


def mean_of_each(figures: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """Average each figure with `mean_of_finite` over those that have it."""
    keys = dict.fromkeys(key for frame in figures for key in frame)
    return {key: mean_of_finite(frame.get(key) for frame in figures) for key in keys}


def root_mean_square(values: F64) -> float:
    """Compute the root mean square of an array of any shape; NaN without values."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def ratio(count: int, total: int) -> float:
    """Divide two counts; NaN where the total is zero."""
    return count / total if total else float("nan")
