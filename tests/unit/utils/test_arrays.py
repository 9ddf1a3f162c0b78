"""Checks of points."""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import in_box


def test_a_box_includes_its_faces_and_no_point_without_coordinates() -> None:
    """Each coordinate is compared with its own sides."""
    low, high = (0.0, -1.0, 5.0), (1.0, 1.0, 9.0)
    inside = [[0.0, -1.0, 5.0], [1.0, 1.0, 9.0], [0.5, 0.0, 7.0]]
    outside = [[1.1, 0.0, 7.0], [0.5, -1.1, 7.0], [0.5, 0.0, 0.5], [np.nan, 0.0, 7.0]]
    found = in_box(np.array(inside + outside), low, high)
    assert found.tolist() == [True] * len(inside) + [False] * len(outside)
    assert in_box(np.zeros((0, 3)), low, high).shape == (0,)
