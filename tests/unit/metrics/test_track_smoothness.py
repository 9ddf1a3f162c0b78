"""Jitter of trajectories whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.metrics.trajectories import jitter_mm, share_followed
from sabench.utils.arrays import F64, I64


def trajectories(frames: int, noise: float) -> tuple[list[I64], list[F64]]:
    """Two thousand particles on parabolas; each frame numbers them in another order."""
    rng = np.random.default_rng(8)
    start, velocity, bend = rng.standard_normal((3, 2000, 3))
    numbers, positions = [], []
    for frame in range(frames):
        order = rng.permutation(2000)
        exact = start + velocity * frame + 0.5 * bend * frame**2
        numbers.append(order)
        positions.append((exact + noise * rng.standard_normal(exact.shape))[order])
    return numbers, positions


@pytest.mark.parametrize("noise", [0.01, 0.3])
def test_jitter_is_the_noise(noise: float) -> None:
    assert jitter_mm(*trajectories(6, noise)) == pytest.approx(noise, rel=0.05)


def test_share_followed() -> None:
    numbers = [np.array([1, 2, 3]), np.array([2, 1]), np.array([1, 4])]
    assert share_followed(numbers, 3) == pytest.approx(3 / 7)
    assert share_followed(numbers, 2) == pytest.approx(5 / 7)
    assert np.isnan(share_followed([], 3))
