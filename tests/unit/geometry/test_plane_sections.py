"""Plane sections of boxes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from sabench.geometry.grid import cut_box
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.utils.arrays import F64

LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([2.0, 3.0, 4.0])


def area(normal: F64, point: F64) -> float:
    corners = cut_box(LOW, HIGH, point, normal)
    np.testing.assert_allclose((corners - point) @ normal, 0.0, atol=1e-12)
    assert (corners >= LOW - 1e-12).all()
    assert (corners <= HIGH + 1e-12).all()
    return float(ConvexHull(corners @ frame_of_normal(normal)[:2].T).volume)


@pytest.mark.parametrize(
    ("normal", "expected"),
    [
        ([0.0, 0.0, 1.0], 6.0),
        ([1.0, 0.0, 0.0], 12.0),
        ([0.0, 0.8, 0.6], 2.0 * 3.0 / 0.6),  # 3 mm of Y, seen along Z
        ([2.0 / 7.0, 3.0 / 7.0, 6.0 / 7.0], 6.0 / (6.0 / 7.0)),
    ],
)
def test_sections_through_the_middle_have_known_areas(normal: list[float], expected: float) -> None:
    assert area(np.array(normal), (LOW + HIGH) / 2.0) == pytest.approx(expected)
