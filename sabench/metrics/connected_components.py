"""Connected components (26 neighbours) of bright voxels of a volume."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label

from sabench.utils.arrays import F32, F64


def component_sums(volume: F32, floor: float) -> F64:
    """Sum E, E x, E y and E z over the voxels of each component of E >= floor.

    Returns (n, 4), in the order of the components' first voxels.
    """
    numbers, count = label(volume >= floor, np.ones((3, 3, 3), dtype=np.bool_))
    sums = np.zeros((4, count))
    for z, (plane, own) in enumerate(zip(volume, numbers, strict=True)):
        y, x = np.nonzero(own)
        component, weight = own[y, x] - 1, plane[y, x].astype(np.float64)
        for total, place in zip(sums, (1.0, x, y, float(z)), strict=True):
            total += np.bincount(component, weights=weight * place, minlength=count)
    return np.ascontiguousarray(sums.T)
