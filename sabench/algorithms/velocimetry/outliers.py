"""Validation of vectors and replacement of invalid ones."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, median_filter

from sabench.utils.arrays import F64, Bool
from sabench.utils.compiled import numba

_REACH = 3.0  # standard deviations that a Gaussian reaches
_FLOOR = 0.1  # voxels: a fluctuation that any measurement has; Westerweel and Scarano (2005)


def within_deviations(shift: F64, valid: Bool, deviations: float) -> Bool:
    """Mark vectors (z, y, x, 3) near the mean of all valid ones.

    Each component is at most so many standard deviations from its mean.
    """
    if not valid.any():
        return valid
    known = shift[valid]
    near = np.abs(shift - known.mean(axis=0)) <= deviations * known.std(axis=0) + _FLOOR
    return np.asarray(valid & near.all(axis=-1))


def near_the_median(shift: F64, valid: Bool, times: float) -> Bool:
    """Mark vectors near the median of their 26 neighbours.

    Near means at most `times` the median of these neighbours' own distances from it. Beyond the
    edges fields are extrapolated linearly; otherwise the median would be biased inwards there.
    Source: J. Westerweel and F. Scarano, Universal outlier detection for PIV data, Exp. Fluids 39,
    1096-1100, 2005, in three dimensions.
    """
    around = np.where(valid[..., None], shift, np.nan)
    padding = [(min(1, count - 1),) * 2 for count in shift.shape[:3]]
    padded = np.pad(around, [*padding, (0, 0)], mode="reflect", reflect_type="odd")
    margin = [*((1 - before,) * 2 for before, _ in padding), (0, 0)]
    padded = np.pad(padded, margin, constant_values=np.nan)
    middle, spread = np.empty_like(shift), np.empty_like(shift)
    medians(padded, middle, spread)
    # never far, where there are no neighbours
    usual = np.linalg.norm(spread, axis=-1) + _FLOOR
    far = np.linalg.norm(shift - middle, axis=-1) > times * usual
    return np.asarray(valid & ~far)


def fill_invalid(shift: F64, valid: Bool) -> F64:
    """Replace invalid vectors by means of valid neighbours, from the edges in.

    Vectors are 0 if none is valid.
    """
    out, known = np.where(valid[..., None], shift, 0.0), valid.copy()
    if not known.any():
        return out
    while not known.all():
        total, count = _around(out * known[..., None]), _around(known[..., None].astype(np.float64))
        fresh = ~known & (count[..., 0] > 0.5)
        out[fresh] = total[fresh] / count[fresh]
        known |= fresh
    return out


def _around(values: F64) -> F64:
    """Sum over the 3 x 3 x 3 nearest, with zeros beyond the edges."""
    for axis in range(3):
        padded = np.pad(values, [(int(n == axis),) * 2 for n in range(values.ndim)])
        count = values.shape[axis]
        before, own, after = (np.take(padded, range(n, n + count), axis) for n in range(3))
        values = own + after + before
    return values


def smooth_vectors(shift: F64, sigma: tuple[float, float, float]) -> F64:
    """Smooth vectors by a Gaussian (z, y, x), extrapolated linearly at edges.

    Its widths are in vectors.
    """
    radii = [math.ceil(_REACH * own) for own in sigma]
    counts = shift.shape[:3]
    margins = [min(radius, count - 1) for radius, count in zip(radii, counts, strict=True)]
    padding = [*((margin, margin) for margin in margins), (0, 0)]
    wide = np.moveaxis(np.pad(shift, padding, mode="reflect", reflect_type="odd"), -1, 0)
    inner = tuple(slice(margin, margin + n) for margin, n in zip(margins, counts, strict=True))
    smooth = [gaussian_filter(axis, sigma, mode="nearest", radius=radii)[inner] for axis in wide]
    return np.stack(smooth, axis=-1)


def thesis_local(shift: F64, valid: Bool, deviations: float) -> Bool:
    """Mark vectors near their 3 x 3 x 3 median, in its deviations.

    See the thesis, section 2.3.3.
    """
    ok = valid.copy()
    for axis in range(3):
        own = shift[..., axis]
        middle = median_filter(own, 3, mode="nearest")
        mean, square = (
            _around(values[..., None])[..., 0] / _around(np.ones((*own.shape, 1)))[..., 0]
            for values in (own, own**2)
        )
        ok &= (
            np.abs(own - middle) <= deviations * np.sqrt(np.maximum(square - mean**2, 0.0)) + 1e-12
        )
    return ok


@numba.njit(cache=True, parallel=True)
def medians(padded: Any, middle: Any, spread: Any) -> None:
    """Fill in the medians of every vector's 26 neighbours, component by component.

    Also fills in the medians of these neighbours' distances from them.

    Parameters
    ----------
    padded : (z + 2, y + 2, x + 2, 3) with NaN for vectors that do not count; where none does, both
        medians are NaN.
    middle, spread : (z, y, x, 3).
    """
    deep, high, wide = middle.shape[:3]
    for job in numba.prange(deep * high):
        z, y = job // high, job % high
        values = np.empty(26)
        for x in range(wide):
            for axis in range(3):
                count = 0
                for k in range(3):
                    for j in range(3):
                        for i in range(3):
                            value = padded[z + k, y + j, x + i, axis]
                            if (k != 1 or j != 1 or i != 1) and not np.isnan(value):
                                values[count] = value
                                count += 1
                half = _median(values, count)
                for n in range(count):
                    values[n] = abs(values[n] - half)
                middle[z, y, x, axis], spread[z, y, x, axis] = half, _median(values, count)


@numba.njit(cache=True)
def _median(values: Any, count: int) -> Any:
    """Compute the median of the first values, which are left in order."""
    if count == 0:
        return np.nan
    for n in range(1, count):
        value, slot = values[n], n
        while slot > 0 and values[slot - 1] > value:
            values[slot] = values[slot - 1]
            slot -= 1
        values[slot] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])
