"""Gains of a triangulation: the least-squares displacement for each pixel of error."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.calibration.disparity import _compute_step, _gains


def test_a_step_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(6)
    for cameras in (2, 3, 5):
        slopes, misses = rng.normal(size=(cameras, 2, 3)), rng.normal(size=(cameras, 2))
        gains, step = np.zeros((cameras, 2, 3)), np.zeros(3)
        assert _gains(slopes, cameras, gains)
        _compute_step(gains, misses, cameras, step)
        expected = np.linalg.lstsq(slopes.reshape(-1, 3), misses.ravel(), rcond=None)[0]
        np.testing.assert_allclose(step, expected, rtol=1e-9)


def test_parallel_lines_of_sight_have_no_solution() -> None:
    slopes = np.tile(np.array([[1.0, 0.0, 0.2], [0.0, 1.0, -0.1]]), (3, 1, 1))
    assert not _gains(slopes, 3, np.zeros((3, 2, 3)))
