"""The most probable light of a particle, against a general optimiser."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize

from sabench.algorithms.particles.joint_fit import (
    even_covariance,
    factorise,
    fill_inverse_diagonal,
    find_light,
    guess_light,
    learn_covariance,
    light_cost,
    log_determinant,
    scatter_between,
)
from sabench.utils.arrays import F64

TYPICAL = np.array([100.0, 120.0, 80.0, 100.0])


def best(signal: F64, weight: F64, precision: F64) -> tuple[F64, float]:
    logs = np.zeros(4)
    guess_light(signal, weight, TYPICAL, logs)
    cost = find_light(signal, weight, TYPICAL, precision, logs, np.zeros(4), np.zeros((4, 4)))
    return logs, cost


@pytest.mark.parametrize("scatter", [0.05, 0.4])
@pytest.mark.parametrize("noise", [2.0, 60.0])
def test_the_light_found_is_the_most_probable(scatter: float, noise: float) -> None:
    precision: F64 = np.linalg.inv(even_covariance(4, scatter, 0.5)).astype(np.float64)
    rng = np.random.default_rng(1)
    for _ in range(5):
        light = TYPICAL * np.exp(rng.multivariate_normal(np.zeros(4), np.linalg.inv(precision)))
        weight = np.full(4, 1.0 / noise**2)
        signal = weight * (light + noise * rng.standard_normal(4))

        def cost(logs: F64, signal: F64 = signal, weight: F64 = weight) -> float:
            return float(light_cost(signal, weight, TYPICAL, precision, logs))

        logs, least = best(signal, weight, precision)
        starts = [minimize(cost, start * np.ones(4)).fun for start in (-1.0, 0.0, 0.5)]
        assert least <= min(starts) + 1e-3
        assert least == pytest.approx(cost(logs))


def test_a_camera_that_sees_nothing_gets_the_light_that_the_others_suggest() -> None:
    precision: F64 = np.linalg.inv(even_covariance(4, 0.05, 0.5)).astype(np.float64)
    weight = np.array([1.0, 1.0, 1.0, 0.0])
    logs, _ = best(1.5 * TYPICAL * weight, weight, precision)
    np.testing.assert_allclose(logs, math.log(1.5), atol=0.02)


def test_the_cost_is_a_log_probability() -> None:
    """Against the normal densities of data and lights, relative to no light."""
    covariance = even_covariance(4, 0.3, 0.4)
    weight, data = np.array([0.2, 0.3, 0.1, 0.4]), np.array([90.0, 130.0, 70.0, 20.0])
    logs = np.array([0.1, -0.2, 0.3, -0.4])
    light = TYPICAL * np.exp(logs)
    squares = weight * ((data - light) ** 2 - data**2)
    expected = 0.5 * squares.sum() + 0.5 * logs @ np.linalg.solve(covariance, logs)
    cost = light_cost(weight * data, weight, TYPICAL, np.linalg.inv(covariance), logs)
    assert cost == pytest.approx(expected)


def test_covariances_are_learned_in_spite_of_outliers() -> None:
    true = even_covariance(4, 0.3, 0.4)
    true[0, 2] = true[2, 0] = 0.24  # two cameras that see much the same lobe
    rng = np.random.default_rng(2)
    logs = 0.7 + rng.multivariate_normal(np.zeros(4), true, 2000)
    logs[:40] = rng.uniform(-4.0, 4.0, (40, 4))
    found = learn_covariance(logs)
    np.testing.assert_allclose(found, true, atol=0.05)
    few = learn_covariance(logs[40:70])  # few tell little more than the average
    assert few[0, 2] == pytest.approx(few[0, 1], abs=0.05)


def test_scatter_between_cameras_leaves_out_what_they_share() -> None:
    assert scatter_between(even_covariance(5, 0.3, 2.0)) == pytest.approx(0.3)
    assert scatter_between(np.array([[0.2]])) == pytest.approx(math.sqrt(0.2))


def test_factors_give_the_determinant() -> None:
    matrix = even_covariance(6, 0.3, 0.4)
    factor = matrix.copy()
    factorise(factor)
    assert log_determinant(factor) == pytest.approx(np.linalg.slogdet(matrix)[1])
    np.testing.assert_allclose(np.tril(factor) @ np.tril(factor).T, matrix)


def test_the_inverse_of_a_factorised_matrix_has_this_diagonal() -> None:
    matrix = np.random.default_rng(6).standard_normal((5, 5))
    matrix = matrix @ matrix.T + np.eye(5)
    factor, diagonal = matrix.copy(), np.zeros(5)
    factorise(factor)
    fill_inverse_diagonal(factor, diagonal, np.zeros(5))
    np.testing.assert_allclose(diagonal, np.diag(np.linalg.inv(matrix)))
