"""Tests of errors of velocities and accelerations."""

from __future__ import annotations

import numpy as np

from sabench.metrics.trajectories import accelerations, claimed_errors, median_errors


def test_second_differences_are_exact_where_acceleration_is_constant() -> None:
    place, velocity, acceleration = np.random.default_rng(3).normal(size=(3, 5, 3))
    step = 0.2
    numbers = [np.array([4, 1, 7, 2, 9]), np.array([9, 7, 1, 4, 3]), np.array([1, 9, 4, 8, 5])]
    order = {4: 0, 1: 1, 7: 2, 2: 3, 9: 4}
    frames = []
    for number, time in zip(numbers, (-step, 0.0, step), strict=True):
        rows = np.array([order.get(one, 0) for one in number.tolist()])
        at = place + velocity * time + acceleration * time**2 / 2.0
        frames.append((number, at[rows]))
    rows, found = accelerations(frames, step)
    assert sorted(numbers[1][rows].tolist()) == [1, 4, 9]  # those in all three frames
    expected = acceleration[[order[one] for one in numbers[1][rows].tolist()]]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_errors_are_medians_over_all_frames() -> None:
    one = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    off, size = claimed_errors([(one + np.array([0.0, 0.0, 0.3]), one), (one[:1] * 1.1, one[:1])])
    np.testing.assert_allclose(off, [0.3, 0.3, 0.1])
    error, percent = median_errors(off, size)
    np.testing.assert_allclose([error, percent], [0.3, 15.0])
