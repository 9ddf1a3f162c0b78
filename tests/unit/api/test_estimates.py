"""Tests of what estimates of particles may claim."""

import numpy as np
import pytest

from sabench.api import FoundParticles
from tests.helpers.refusals import refused

_PLACES = np.arange(6.0).reshape(2, 3)


def test_rows_keep_all_that_is_known() -> None:
    found = FoundParticles(
        _PLACES,
        light=np.ones((2, 4)),
        covariance_mm2=np.array([np.eye(3), 2.0 * np.eye(3)]),
        probability=np.array([1.0, 0.5]),
        trajectory=np.array([7, 9]),
    )
    one = found.rows(np.array([False, True]))
    np.testing.assert_array_equal(one.position_mm, _PLACES[1:])
    np.testing.assert_array_equal(one.light, np.ones((1, 4)))
    np.testing.assert_array_equal(one.covariance_mm2, [2.0 * np.eye(3)])
    np.testing.assert_array_equal(one.probability, [0.5])
    np.testing.assert_array_equal(one.trajectory, [9])
    assert one.velocity_mm_s is None


@pytest.mark.parametrize("wrong", [1.01, -1e-9])
def test_a_probability_is_between_0_and_1(wrong: float) -> None:
    with refused("probability"):
        FoundParticles(_PLACES, probability=np.array([0.5, wrong]))


@pytest.mark.parametrize(
    "name", ["covariance_mm2", "velocity_covariance", "acceleration_covariance"]
)
def test_a_covariance_is_symmetric_and_positive(name: str) -> None:
    askew = np.eye(3) + 0.5 * np.eye(3, k=1)
    for wrong in (np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 1.0, -1.0]), askew):
        with refused(name, "particle 1"):
            FoundParticles(_PLACES, **{name: np.array([np.eye(3), wrong])})


def test_rounding_leaves_a_covariance_one() -> None:
    matrix = np.diag([1e-6, 2e-6, 3e-6])
    matrix[0, 1] = 1e-15
    found = FoundParticles(_PLACES[:1], covariance_mm2=matrix[None])
    np.testing.assert_array_equal(found.covariance_mm2, matrix[None])
