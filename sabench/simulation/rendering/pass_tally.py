"""Passes of pixels: mean, scatter, and how many an accuracy asks for."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from sabench.utils.arrays import F64, I64, Bool

# lattices of a pixel, whose passes take turns: the scatter of their means is the error
STREAMS = 4
# weight of the neighbours' errors next to `STREAMS` - 1 of a pixel's own: two images of bubbles
# then differ by a little less than their errors tell
_AROUND = 0.7
# passes at least of pixels, and of those around them, with more than the error asked for
_ROUGH = 16
# factor of a pixel's passes, at most, from what they tell so far; trials of which get more passes
_GROWTH, _TRIALS = 2, 4
_MOST = 1 << 14  # passes of a pixel at most: a guard


class PassTally:
    """Number, mean and scatter of every pixel's passes.

    Parameters
    ----------
    counted : (rows, columns) the pixels whose mean error is to be reached: those that show
        something. With an even background among them, errors elsewhere could be of any size.

    Attributes
    ----------
    count : (n,) of the pixels, row by row: a multiple of `STREAMS`.
    """

    def __init__(self, counted: Bool) -> None:
        """Start without passes."""
        size = counted.size
        self._shape, self._counted = counted.shape, counted.ravel()
        self.count = np.zeros(size, dtype=np.int64)
        self._sums = np.zeros((size, STREAMS))

    def add(self, where: I64, more: I64, values: F64) -> None:
        """Add passes of some pixels, so many `more` of each, one pixel's after the other."""
        _add_passes(self._sums, self.count, where, more, values)

    @property
    def mean(self) -> F64:
        """Means (n,) of the pixels."""
        return np.asarray(np.einsum("ij->i", self._sums) / self.count)

    def errors(self, floor: float) -> F64:
        """Compute standard errors over values, or over `floor` in darker pixels.

        A few streams that have found a pixel dark may have missed what its neighbours show: the
        variance of a pass is mixed with the mean over nine pixels.
        """
        from scipy.ndimage import uniform_filter  # takes long to load

        variance = np.empty(len(self.count))
        _fill_variances(self._sums, self.count, variance)
        around = uniform_filter(variance.reshape(self._shape), 3).ravel()
        own = STREAMS - 1
        mixed = (own * variance + _AROUND * around) / (own + _AROUND)
        error = np.sqrt(np.maximum(mixed, 0.0) / self.count)
        return np.asarray(error / np.maximum(self.mean, max(floor, 1e-300)))

    def mean_error(self, off: F64) -> float:
        """Compute the mean of errors `off` (n,) over pixels that count; 0 without any."""
        return float(off[self._counted].mean()) if self._counted.any() else 0.0

    def wanted(self, off: F64, error: float) -> I64:
        """Tell how many passes (n,) bring the mean of the errors `off` to `error`.

        The fewest rays do so if a pixel's passes go with the power 2/3 of a pass's error. Pixels
        that do not count get as many as others of their error, until that is `error`.
        """
        from scipy.ndimage import maximum_filter

        if self.mean_error(off) <= error:
            return self.count
        one, counted = off * np.sqrt(self.count), self._counted
        share, more = one ** (2.0 / 3.0), counted
        for _ in range(_TRIALS):
            rest = error * counted.sum() - off[counted & ~more].sum()
            factor = (share[more].sum() / max(rest, 1e-6 * error)) ** 2
            more = counted & (factor * share > self.count)
        rough = maximum_filter((off > error).reshape(self._shape), 3).ravel()
        wanted = np.where(counted, factor * share, np.minimum(factor * share, (one / error) ** 2))
        wanted = np.maximum(np.ceil(wanted), np.where(rough, _ROUGH, 0))
        wanted = np.minimum(wanted, np.minimum(_GROWTH * self.count, _MOST))
        wanted = STREAMS * np.ceil(wanted / STREAMS).astype(np.int64)
        return np.asarray(np.maximum(wanted, self.count))


@numba.njit(cache=True)
def _add_passes(
    sums: Any, count: Any, where: Any, more: Any, values: Any
) -> None:  # pragma: no cover
    """Add `more` passes of each pixel `where` to its streams, which take turns."""
    streams = sums.shape[1]
    total, n = np.empty(streams), 0
    for k in range(len(where)):
        total[:] = 0.0
        for turn in range(more[k]):
            total[turn % streams] += values[n]
            n += 1
        for stream in range(streams):
            sums[where[k], stream] += total[stream]
        count[where[k]] += more[k]


@numba.njit(cache=True)
def _fill_variances(sums: Any, count: Any, variance: Any) -> None:
    """Fill in the variances (n,) of passes, from the sums (n, stream) of streams."""
    streams = sums.shape[1]
    for n in range(len(sums)):
        mean, squares = 0.0, 0.0
        for k in range(streams):
            mean += sums[n, k] / streams
        for k in range(streams):
            squares += (sums[n, k] - mean) ** 2
        variance[n] = squares / (streams - 1) * streams / count[n]
