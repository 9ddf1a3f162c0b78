"""Bounds of mean lengths, against drawn numbers."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.calibration.cramer_rao import _mean_length


@pytest.mark.parametrize(
    ("uu", "vv", "uv"), [(1.0, 1.0, 0.0), (4.0, 0.25, 0.0), (1.0, 2.0, 1.2), (3.0, 0.0, 0.0)]
)
def test_mean_lengths_are_those_of_normal_pairs(uu: float, vv: float, uv: float) -> None:
    pairs = np.random.default_rng(1).multivariate_normal([0.0, 0.0], [[uu, uv], [uv, vv]], 400_000)
    expected = np.linalg.norm(pairs, axis=1).mean()
    found = _mean_length(np.array([uu]), np.array([vv]), np.array([uv]))
    assert found[0] == pytest.approx(expected, rel=0.005)
