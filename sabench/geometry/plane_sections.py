"""Plane sections of boxes."""

from __future__ import annotations

import itertools

import numpy as np

from sabench.utils.arrays import F64


def cut_box(low_mm: F64, high_mm: F64, point_mm: F64, normal: F64) -> F64:
    """Cut the edges of a box along the world's axes with a plane.

    Parameters
    ----------
    low_mm, high_mm : (3,) corners of the box with the smallest and largest coordinates.
    point_mm, normal : (3,) a point of the plane, and its unit normal.

    Returns
    -------
    Corners (n, 3) of the part of the plane in the box, in no order, some of them repeatedly where
    the plane passes through corners of the box; none where it misses the box.
    """
    corners = np.array(list(itertools.product(*zip(low_mm, high_mm, strict=True))))
    away = (corners - point_mm) @ normal
    cuts = []
    for one, other in itertools.combinations(range(8), 2):
        if (one ^ other).bit_count() == 1 and away[one] * away[other] <= 0.0:
            length = away[one] - away[other]
            share = away[one] / length if length else 0.0
            cuts.append(corners[one] + share * (corners[other] - corners[one]))
    return np.array(cuts).reshape(-1, 3)
