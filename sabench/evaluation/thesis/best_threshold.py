"""Q of a refocused volume for many thresholds in one pass.

It needs the truth: it judges thresholds, and no solver can use it.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from sabench.algorithms.refocus.thresholding import plane_statistics
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba

_ALL = (slice(None), slice(None), slice(None))
_KS = np.linspace(0.0, 40.0, 801)
_FLAT = 1e-30


def quality_of_k(
    volume: F32,
    synthesised: F32,
    ks: F64,
    keep: Literal["reduced", "whole"],
    scored: tuple[slice, slice, slice] = _ALL,
) -> F64:
    """Compute Q (K,) of `extract(volume, k, keep)` for ascending thresholds (K,).

    It takes one pass and does not change the volume.

    Parameters
    ----------
    volume, synthesised : (z, y, x) refocused planes as they are, and E_s.
    scored : the part of the volume that Q sums over; mean and standard deviation are those of whole
        planes.

    What lies between two thresholds enters both sums of equation 2.13 through its number, sum and
    sum of squares: with t the threshold, sum (E - t)^2 = sum E^2 - 2 t sum E + n t^2, and so on.
    """
    means, spreads = plane_statistics(volume[scored[0]])
    thresholds = (means[:, None] + spreads[:, None] * ks).astype(
        np.float32
    )  # single precision, as in `extract`
    sums = np.zeros((len(means), len(ks) + 1, 6))
    _sum_between(volume[scored], synthesised[scored], thresholds, sums)
    count, light, square, truth, product, _ = np.moveaxis(
        np.cumsum(sums[:, :0:-1], axis=1)[:, ::-1], 2, 0
    )
    if keep == "reduced":
        t = thresholds.astype(np.float64)
        product, square = product - t * truth, square - 2.0 * t * light + t**2 * count
    norm = np.sqrt(np.maximum(square.sum(axis=0), 0.0) * sums[:, :, 5].sum())
    return np.asarray(np.divide(product.sum(axis=0), norm, out=np.zeros(len(ks)), where=norm > 0.0))


def best_k(
    volume: F32,
    synthesised: F32,
    keep: Literal["reduced", "whole"],
    scored: tuple[slice, slice, slice] = _ALL,
) -> tuple[float, float]:
    """Find the threshold k, to 0.05, with the highest Q, and that Q.

    The thesis selects it so in its simulations, with the truth. Arguments as for `quality_of_k`.
    """
    q = quality_of_k(volume, synthesised, _KS, keep, scored)
    return float(_KS[q.argmax()]), float(q.max())


@numba.njit(cache=True, parallel=True)
def _sum_between(volume: Any, synthesised: Any, thresholds: Any, sums: Any) -> None:
    """Sum over the voxels above exactly i thresholds of their plane.

    sums[plane, i] is their number, and the sums of E, E^2, E_s, E E_s and E_s^2 over them.

    Of voxels above none, which are most, only the last sum is taken: nothing else of theirs enters
    Q.
    """
    for plane in numba.prange(len(volume)):
        lowest, last = thresholds[plane, 0], thresholds.shape[1]
        scale = (last - 1) / max(thresholds[plane, last - 1] - lowest, _FLAT)
        for row in range(volume.shape[1]):
            rest = 0.0
            for column in range(volume.shape[2]):
                value, truth = (
                    volume[plane, row, column],
                    np.float64(synthesised[plane, row, column]),
                )
                if value <= lowest:
                    rest += truth * truth
                    continue
                above = min(
                    int((value - lowest) * scale), last
                )  # right or nearly, if thresholds are evenly spaced
                while above < last and thresholds[plane, above] < value:
                    above += 1
                while thresholds[plane, above - 1] >= value:
                    above -= 1
                total = sums[plane, above]
                total[0] += 1.0
                total[1] += value
                total[2] += np.float64(value) * value
                total[3] += truth
                total[4] += value * truth
                total[5] += truth * truth
            sums[plane, 0, 5] += rest
