"""Tests of errors against bounds and claims."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sabench.metrics.particle_bounds import brier_score, coverage, rms_over_bound, squared_distance


def test_squared_distances_are_those_of_the_inverse_covariance() -> None:
    covariance = np.array([np.diag([4.0, 1.0, 0.25])])
    np.testing.assert_allclose(squared_distance(np.array([[2.0, 1.0, 0.5]]), covariance), [3.0])


@pytest.mark.parametrize("nominal", [0.68, 0.95])
def test_normal_errors_are_covered_as_claimed(nominal: float) -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(20_000, 3, 3))
    error = (root @ rng.normal(size=(20_000, 3, 1)))[:, :, 0]
    covariance = root @ root.transpose(0, 2, 1)
    assert coverage(error, covariance, nominal) == pytest.approx(1.0, abs=0.015)
    assert coverage(3.0 * error, covariance, nominal) < 0.5
    assert rms_over_bound(2.0 * error, covariance) == pytest.approx(2.0, abs=0.03)


def test_particles_without_a_bound_are_left_out() -> None:
    bound = np.array([np.eye(3), np.full((3, 3), np.nan)])
    error = np.array([[1.0, 1.0, 1.0], [9.0, 9.0, 9.0]])
    assert rms_over_bound(error, bound) == pytest.approx(1.0)
    assert math.isnan(rms_over_bound(error[1:], bound[1:]))
    assert math.isnan(coverage(np.zeros((0, 3)), np.zeros((0, 3, 3)), 0.68))


def test_probabilities_are_scored_by_what_is_true() -> None:
    true = np.array([True, True, False])
    assert brier_score(np.array([1.0, 1.0, 0.0]), true) == 0.0
    assert brier_score(np.array([0.5, 0.5, 0.5]), true) == pytest.approx(0.25)
    assert math.isnan(brier_score(np.zeros(0), np.zeros(0, dtype=np.bool_)))
