"""Means over seeds, with their confidence intervals."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Mean:
    """Mean of `count` independent values, with its confidence interval.

    Attributes
    ----------
    half_width : of the 95 % interval; None for a single value.
    """

    mean: float
    half_width: float | None
    count: int

    def text(self, decimals: int) -> str:
        """Format as `0.750 ± 0.004`, or the mean alone."""
        spread = "" if self.half_width is None else f" ± {self.half_width:.{decimals}f}"
        return f"{self.mean:.{decimals}f}{spread}"


def mean_of(values: Sequence[float]) -> Mean | None:
    """Compute the mean with Student's t-interval; None without values.

    The values are taken to come from a normal distribution of unknown variance.
    """
    count = len(values)
    if not count:
        return None
    if count == 1:
        return Mean(float(values[0]), None, 1)
    error = float(np.std(values, ddof=1)) / math.sqrt(count)
    return Mean(float(np.mean(values)), quantile(count) * error, count)


@functools.cache
def quantile(count: int) -> float:
    """Compute Student's quantile for the mean of two or more values."""
    from scipy.special import stdtrit  # takes long to load

    return float(stdtrit(count - 1, (1.0 + CONFIDENCE) / 2.0))
