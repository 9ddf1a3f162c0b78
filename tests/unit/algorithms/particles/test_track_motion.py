"""Tests of motion from the positions of tracks."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.kalman_tracks import most_probable_motion
from sabench.utils.arrays import F64

_TIMES = 1e-3 * np.arange(-3.0, 4.0)
_WIDE = 1e18


def _estimate(position: F64, variance: F64, times: F64 = _TIMES, jerk: float = 0.0) -> F64:
    count = len(position)
    still = np.zeros((count, 3))
    state, _ = most_probable_motion(
        times, position, variance, still, np.full((count, 3), _WIDE), _WIDE, jerk
    )
    return state


def test_a_parabola_is_found_exactly() -> None:
    state = np.array([[50.0, -20.0, 3.0], [120.0, 40.0, -70.0], [3e3, -9e3, 1e3]])
    terms = np.stack([np.ones(7), _TIMES, _TIMES**2 / 2.0], axis=1)
    position = (terms @ state)[None]
    found = _estimate(position, np.full((1, 7, 3), 1e-4), jerk=1e3)
    np.testing.assert_allclose(found[0], state, rtol=1e-6)


def test_positions_that_are_not_there_do_not_count() -> None:
    rng = np.random.default_rng(3)
    position, variance = rng.normal(size=(5, 7, 3)), rng.uniform(0.5, 2.0, size=(5, 7, 3))
    kept = np.array([0, 1, 3, 4, 6])
    part = _estimate(position[:, kept], variance[:, kept], _TIMES[kept], 1e9)
    position[:, [2, 5]] = np.nan
    np.testing.assert_allclose(_estimate(position, variance, jerk=1e9), part, rtol=1e-6)


@pytest.mark.parametrize("jerk", [1e2, 1e6])
def test_errors_are_as_large_as_claimed(jerk: float) -> None:
    """Bodies are moved by many small random jerks, whose sums are no formula of the estimate."""
    rng = np.random.default_rng(5)
    count, steps, noise, acceleration = 3000, 300, 0.01, 2e3
    step = 6e-3 / steps
    state = np.zeros((count, 3, 3))
    state[:, 1] = rng.normal(scale=50.0, size=(count, 3))
    state[:, 2] = rng.normal(scale=acceleration, size=(count, 3))
    at, states = range(0, steps + 1, steps // 6), []
    for number in range(steps + 1):
        if number in at:
            states.append(state.copy())
        state[:, 0] += step * state[:, 1] + step**2 / 2.0 * state[:, 2]
        state[:, 1] += step * state[:, 2]
        state[:, 2] += rng.normal(scale=np.sqrt(jerk / step) * step, size=(count, 3))
    path = np.stack(states, axis=1)
    seen = path[:, :, 0] + rng.normal(scale=noise, size=(count, 7, 3))
    known = (np.full((count, 7, 3), noise**2), np.zeros((count, 3)), np.full((count, 3), 50.0**2))
    state, covariance = most_probable_motion(_TIMES, seen, *known, acceleration**2, jerk)
    error = (state - path[:, 3]).transpose(0, 2, 1)
    squares = np.einsum("nap,napq,naq->na", error, np.linalg.inv(covariance), error)
    assert squares.mean() == pytest.approx(3.0, abs=0.15)


def test_a_single_position_moves_as_it_is_expected_to() -> None:
    position = np.full((1, 7, 3), np.nan)
    position[0, 3] = [1.0, 2.0, 3.0]
    velocity, spread = np.array([[10.0, 20.0, 30.0]]), np.full((1, 3), 4.0)
    state, covariance = most_probable_motion(
        _TIMES, position, np.full((1, 7, 3), 1e-4), velocity, spread, 9.0, 1.0
    )
    np.testing.assert_allclose(
        state[0], [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0], [0.0] * 3], atol=1e-6
    )
    np.testing.assert_allclose(covariance[0, 0].diagonal(), [1e-4, 4.0, 9.0], rtol=1e-6)
