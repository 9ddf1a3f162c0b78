"""Series of the slope of light paths, by which its iteration starts and steps."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.geometry.path_slope import _halley, _lateral, _lateral_distance, _start
from sabench.utils.arrays import F64

PATHS: list[tuple[F64, list[F64 | float]]] = [
    (np.array([1.0, 1.5, 1.333]), [300.0, 6.0, 40.0]),
    (np.array([1.0, 1.5, 1.46, 1.333]), [20.0, 10.0, 30.0, 200.0]),
    (np.array([1.333, 1.0]), [5.0, 80.0]),
    (np.array([1.7, 1.2, 1.0]), [10.0, 40.0, 0.1]),
]


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS)
def test_derivatives_are_those_of_the_lateral_distance(
    relative: F64, depths_mm: list[F64 | float]
) -> None:
    """Central differences; the second derivative is stated over -3 t."""
    slope, step = np.array([0.05, 0.3, 0.8, 2.0]), 1e-4
    value, gradient, curvature = _lateral_distance(relative, depths_mm, slope)
    before, after = (_lateral(relative, depths_mm, slope + by) for by in (-step, step))
    np.testing.assert_allclose(value, _lateral(relative, depths_mm, slope)[0], rtol=1e-13)
    np.testing.assert_allclose(gradient, (after[0] - before[0]) / (2.0 * step), rtol=1e-6)
    np.testing.assert_allclose(
        curvature, (after[1] - before[1]) / (2.0 * step) / (-3.0 * slope), rtol=1e-4
    )


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS)
def test_the_first_slope_is_right_to_the_third_power(
    relative: F64, depths_mm: list[F64 | float]
) -> None:
    """Half the slope leaves a 32nd of the error: it is of fifth order."""
    slope = np.array([2e-2, 1e-2])
    error = _start(relative, depths_mm, _lateral(relative, depths_mm, slope)[0]) - slope
    assert error[0] / error[1] == pytest.approx(32.0, rel=0.1)


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS)
def test_the_first_slope_is_right_for_flat_paths(
    relative: F64, depths_mm: list[F64 | float]
) -> None:
    """A path far longer than it is deep lies in the rarest medium."""
    slope = np.array([1e5])
    start = _start(relative, depths_mm, _lateral(relative, depths_mm, slope)[0])
    np.testing.assert_allclose(start, slope, rtol=0.05)


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS[:3])
def test_halley_converges_without_a_bracket(relative: F64, depths_mm: list[F64 | float]) -> None:
    """Steep and flat paths alike need few steps, unless the rarest layer is thin."""
    slope = np.geomspace(1e-3, 1e2, 60)
    found = _halley(relative, depths_mm, _lateral(relative, depths_mm, slope)[0])
    assert found is not None
    np.testing.assert_allclose(found[0], slope, rtol=1e-9)
