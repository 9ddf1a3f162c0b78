"""Passes of pixels: mean, scatter, and how many an accuracy asks for."""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64, I64

FIRST_PASSES = 4  # of each pixel, at least: their scatter is the error
# passes at least of pixels, and of those around them, with more than the error asked for
_ROUGH = 16
# factor of a pixel's passes, at most, from what they tell so far; trials of which get more passes
_GROWTH, _TRIALS = 2, 4
_MOST = 1 << 14  # passes of a pixel at most: a guard


class PassTally:
    """Number, mean and scatter of every pixel's passes.

    Attributes
    ----------
    count, mean : (n,) of the pixels, row by row.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        """Start without passes, for an image of some rows and columns."""
        size = shape[0] * shape[1]
        self._shape = shape
        self.count = np.zeros(size, dtype=np.int64)
        self.mean, self._squares = np.zeros(size), np.zeros(size)

    def add(self, where: I64, more: I64, values: F64) -> None:
        """Add passes of some pixels, so many `more` of each, one pixel's after the other.

        Source: T. F. Chan, G. H. Golub and R. J. LeVeque, Updating formulae and a pairwise
        algorithm for computing sample variances, COMPSTAT 1982.
        """
        starts = np.cumsum(more) - more
        mean = np.add.reduceat(values, starts) / more
        squares = np.add.reduceat((values - np.repeat(mean, more)) ** 2, starts)
        count, total = self.count[where], self.count[where] + more
        off = mean - self.mean[where]
        self._squares[where] += squares + off**2 * count * more / total
        self.mean[where] += off * more / total
        self.count[where] = total

    def errors(self, floor: float) -> F64:
        """Compute standard errors over values, or over `floor` in darker pixels.

        A few rays that have found a pixel dark may have missed what its neighbours show: variances
        start from the mean over nine pixels, which counts as `FIRST_PASSES` passes.
        """
        from scipy.ndimage import uniform_filter  # takes long to load

        variance = self._squares / np.maximum(self.count - 1, 1)
        around = uniform_filter(variance.reshape(self._shape), 3).ravel()
        mixed = (self.count * variance + FIRST_PASSES * around) / (self.count + FIRST_PASSES)
        error = np.sqrt(np.maximum(mixed, 0.0) / self.count)
        return np.asarray(error / np.maximum(self.mean, max(floor, 1e-300)))

    def wanted(self, off: F64, error: float) -> I64:
        """Tell how many passes (n,) bring the mean of the errors `off` to `error`.

        The fewest rays do so if a pixel's passes go with the power 2/3 of a pass's error.
        """
        from scipy.ndimage import maximum_filter

        if off.mean() <= error:
            return self.count
        one = off * np.sqrt(self.count)
        share, more = one ** (2.0 / 3.0), np.ones(len(off), dtype=np.bool_)
        for _ in range(_TRIALS):
            rest = error - off[~more].sum() / len(off)
            factor = (share[more].sum() / len(off) / max(rest, 1e-6 * error)) ** 2
            more = factor * share > self.count
        rough = maximum_filter((off > error).reshape(self._shape), 3).ravel()
        wanted = np.maximum(np.ceil(factor * share), np.where(rough, _ROUGH, 0))
        wanted = np.minimum(wanted, np.minimum(_GROWTH * self.count, _MOST))
        return np.asarray(np.maximum(wanted.astype(np.int64), self.count))
