"""Tests of the curve over the matching distance, and of duplicates."""

from __future__ import annotations

import numpy as np

from sabench.metrics.particle_detection import count_duplicates, f1_over_distance
from sabench.utils.arrays import Bool

_TRUTH = np.array([[5.0, 5.0, 5.0], [15.0, 5.0, 5.0], [25.0, 5.0, 5.0], [35.0, 5.0, 5.0]])


def _all(count: int) -> Bool:
    return np.ones(count, dtype=np.bool_)


def test_the_curve_rises_where_particles_come_within_reach() -> None:
    found = _TRUTH + np.array([[0.05], [0.25], [0.65], [2.0]]) * [1.0, 0.0, 0.0]
    curve = f1_over_distance(found, _TRUTH, _all(4), _all(4), (0.1, 0.3, 0.5, 0.7, 1.0))
    np.testing.assert_allclose(curve, [0.25, 0.5, 0.5, 0.75, 0.75])


def test_second_detections_of_a_particle_are_duplicates_and_ghosts_are_not() -> None:
    near, far = np.array([0.0, 0.4, 0.0]), np.array([0.0, 3.0, 0.0])
    found = np.concatenate([_TRUTH, _TRUTH[:2] + near, _TRUTH[2:3] + far])
    assert count_duplicates(found, _TRUTH, _all(len(found))) == 2
    unscored = _all(len(found))
    unscored[4] = False
    assert count_duplicates(found, _TRUTH, unscored) == 1
