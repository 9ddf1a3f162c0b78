"""Errors of velocity fields whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.metrics.velocity_error import precision_interval, velocity_scores
from sabench.utils.arrays import F64, Bool

STEP_MM = (0.5, 0.4, 0.8)
VOXEL_MM = (0.1, 0.2, 0.05)
SHAPE = (4, 5, 6)


def linear(slopes: F64) -> F64:
    """A field u_i = sum_j slopes[i, j] x_j on the lattice (z, y, x, 3)."""
    axes = [step * np.arange(count) for step, count in zip(STEP_MM, SHAPE[::-1], strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    points = np.stack([x, y, z], axis=-1).transpose(2, 1, 0, 3)
    return np.asarray(points @ slopes.T)


def scores(estimate: F64, truth: F64, valid: Bool | None = None) -> dict[str, float]:
    there = np.ones(SHAPE, dtype=np.bool_) if valid is None else valid
    return velocity_scores(estimate, truth, there, np.ones_like(there), STEP_MM, 0.02, VOXEL_MM)


def test_a_constant_error_is_a_bias_in_voxels() -> None:
    truth = linear(np.diag([1.0, 2.0, 3.0]))
    got = scores(truth + np.array([1.0, -2.0, 1.5]), truth)
    errors = {"u": 0.2, "v": -0.2, "w": 0.6}
    for axis, error in errors.items():
        assert got[f"{axis}_bias_voxel"] == pytest.approx(error)
        assert got[f"{axis}_rms_voxel"] == pytest.approx(abs(error))
        assert got[f"{axis}_p90_voxel"] == pytest.approx(abs(error))
    assert got["bias_voxel"] == pytest.approx(np.sqrt(0.44))
    assert got["rms_voxel"] == pytest.approx(np.sqrt(0.44))
    assert got["divergence_1_s"] == pytest.approx(0.0, abs=1e-9)
    assert got["vorticity_percent"] == pytest.approx(0.0, abs=1e-9)
    assert got["response"] == pytest.approx(1.0)


def test_errors_to_both_sides_have_no_bias() -> None:
    truth = linear(np.eye(3))
    sign = np.where(np.arange(truth[..., 0].size).reshape(SHAPE) % 2, 1.0, -1.0)
    got = scores(truth + sign[..., None] * np.array([0.5, 0.0, 0.0]), truth)
    assert got["bias_voxel"] == pytest.approx(0.0, abs=1e-12)
    assert got["rms_voxel"] == pytest.approx(0.1)
    assert got["u_rms_voxel"] == pytest.approx(0.1)


def test_errors_of_derivatives_are_those_of_a_linear_field() -> None:
    """Errors of slopes a_ij add their trace, and the curl of a_ij - a_ji, to the derivatives."""
    spin = np.array([[0.0, -3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    wrong = np.array([[0.4, 0.0, 0.6], [0.0, 0.5, 0.0], [0.0, 0.8, -0.2]])
    got = scores(linear(spin + wrong), linear(spin))
    assert got["divergence_1_s"] == pytest.approx(0.7)
    # curl: (a_32 - a_23, a_13 - a_31, a_21 - a_12) = (0.8, 0.6, 0)
    assert got["vorticity_percent"] == pytest.approx(100.0 * np.sqrt(0.8**2 + 0.6**2) / 6.0)
    slow = scores(0.01 * linear(spin + wrong), 0.01 * linear(spin))
    assert slow["vorticity_percent"] == pytest.approx(got["vorticity_percent"])


@pytest.mark.parametrize("node", [(1, 2, 2), (2, 1, 3), (1, 3, 4), (3, 2, 2), (2, 2, 0)])
def test_what_was_not_measured_has_no_influence(node: tuple[int, int, int]) -> None:
    truth = linear(np.array([[0.0, -3.0, 1.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]))
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[node] = False
    estimate = truth.copy()
    estimate[node] = 1e6
    got = scores(estimate, truth, valid)
    assert got["yield_percent"] == pytest.approx(100.0 * 119.0 / 120.0)
    for key in ("rms_voxel", "bias_voxel", "divergence_1_s", "vorticity_percent"):
        assert got[key] == pytest.approx(0.0, abs=1e-9)


def test_nine_tenths_of_the_errors_lie_in_the_interval() -> None:
    errors = np.column_stack([np.linspace(-1.0, 1.0, 2001), np.linspace(0.0, 3.0, 2001)])
    np.testing.assert_allclose(precision_interval(errors), [0.9, 2.7], rtol=1e-3)
