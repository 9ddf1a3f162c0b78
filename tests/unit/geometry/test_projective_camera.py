"""Fits of projective cameras."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from sabench.geometry.projective_camera import fit_projective
from sabench.utils.arrays import F64

MATRIX = np.array(
    [[900.0, 12.0, 310.0, 9e4], [-8.0, 870.0, 240.0, 7e4], [0.05, -0.03, 1.0, 300.0]]
)  # the volume is about 300 mm in front of the camera


def points_of(count: int) -> F64:
    return np.random.default_rng(3).uniform(-20.0, 20.0, (count, 3))


def pixels_of(points: F64) -> F64:
    image = np.column_stack([points, np.ones(len(points))]) @ MATRIX.T
    return np.asarray(image[:, :2] / image[:, 2:])


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e6])
def test_a_fit_does_not_depend_on_the_unit_of_length(unit: float) -> None:
    points = points_of(30)
    found = fit_projective("one", 480, 640, unit * points, pixels_of(points))
    others = points_of(60)[30:]
    np.testing.assert_allclose(found.project(unit * others)[0], pixels_of(others), atol=1e-8)


def test_the_memory_of_a_fit_grows_with_the_points_and_not_their_square() -> None:
    """A square matrix of the 2,000 equations alone would take 32 MB."""
    points = points_of(1000)
    tracemalloc.start()
    try:
        fit_projective("one", 480, 640, points, pixels_of(points))
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 8e6
