"""Errors of a model, told from noise by their correlation between neighbours.

Noise of detection differs from point to point. What a model lacks changes slowly over an image.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sabench.utils.arrays import F64, I64

_NEAREST = 3  # neighbours of a point: along rows and columns of a grid
_REACH = 1.5  # times the distance of the nearest one, beyond which a point is no neighbour


def neighbours(points_mm: F64) -> I64:
    """List pairs (n, 2) of neighbouring points (m, 3)."""
    count = min(_NEAREST + 1, len(points_mm))
    if count < 2:
        return np.zeros((0, 2), dtype=np.int64)
    distances, others = cKDTree(points_mm).query(points_mm, k=count)
    near = distances[:, 1:] <= _REACH * distances[:, 1:2]
    first, rank = np.nonzero(near)
    pairs = np.sort(np.column_stack([first, others[first, rank + 1]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int64)


def correlated_part(errors: F64, pairs: I64) -> F64:
    """Estimate the standard deviation (n,) of errors that neighbours share.

    Parameters
    ----------
    errors : (..., point, n) errors of points; NaN for none.
    pairs : neighbouring points, see `neighbours`.

    The mean product of neighbours' errors is the variance of what changes slowly. NaN without any
    pair.
    """
    products = errors[..., pairs[:, 0], :] * errors[..., pairs[:, 1], :]
    flat = products.reshape(-1, errors.shape[-1])
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.full(errors.shape[-1], np.nan)
    return np.asarray(np.sqrt(np.maximum(flat.mean(axis=0), 0.0)))
