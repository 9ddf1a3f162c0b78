"""Scores of size distributions, and counts with intervals."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.metrics import counts_per_frame, sauter_mm, size_scores


def area_between(own: np.ndarray, true: np.ndarray) -> float:
    """Integrate the difference of two empirical distribution functions."""
    ends = np.sort(np.concatenate([own, true]))
    shares = [
        np.searchsorted(np.sort(one), ends[:-1], side="right") / len(one) for one in (own, true)
    ]
    return float(np.sum(np.abs(shares[0] - shares[1]) * np.diff(ends)))


@pytest.mark.parametrize("count", [40, 57])
def test_the_distance_is_the_area_between_both_distribution_functions(count: int) -> None:
    rng = np.random.default_rng(3)
    own, true = rng.lognormal(-0.7, 0.5, count), rng.lognormal(-0.8, 0.55, 57)
    scores = size_scores(own, true)
    assert scores["sizes_mm"] == pytest.approx(area_between(own, true), rel=1e-9)
    assert scores["sizes_percent"] == pytest.approx(100.0 * scores["sizes_mm"] / true.mean())
    if count == len(true):  # mean difference of equal ranks
        ranks = np.abs(np.sort(own) - np.sort(true)).mean()
        assert scores["sizes_mm"] == pytest.approx(ranks, rel=1e-9)


def test_scores_of_known_faults() -> None:
    true = np.array([0.2, 0.5, 1.0])
    larger = size_scores(1.1 * true, true)
    for key in ("sizes_percent", "mean_percent", "sauter_percent"):
        assert larger[key] == pytest.approx(10.0)
    twice = size_scores(np.concatenate([true, true]), true)
    assert max(twice.values()) == pytest.approx(0.0, abs=1e-9)  # sizes, not numbers
    only_large = size_scores(true[2:], true)
    assert only_large["sizes_mm"] == pytest.approx((0.8 + 0.5) / 3.0)
    assert all(np.isnan(value) for value in size_scores(np.zeros(0), true).values())


def test_d32_is_three_times_volume_over_surface() -> None:
    radius = np.random.default_rng(1).uniform(0.1, 2.0, 50)
    volume, surface = np.sum(4.0 / 3.0 * np.pi * radius**3), np.sum(4.0 * np.pi * radius**2)
    assert sauter_mm(radius) == pytest.approx(6.0 * volume / surface)
    assert sauter_mm(np.full(7, 0.4)) == pytest.approx(0.8)
    assert np.isnan(sauter_mm(np.zeros(0)))


def test_intervals_hold_the_mean_of_the_distribution_as_often_as_they_say() -> None:
    rng = np.random.default_rng(5)
    edges, held = np.array([0.0, 0.5, 1.0]), []
    for _ in range(400):
        frames = [rng.uniform(0.0, 1.0, rng.poisson(40.0)) for _ in range(10)]
        held += [
            abs(m.mean - 20.0) <= (m.half_width or 0.0) for m in counts_per_frame(frames, edges)
        ]
    assert np.mean(held) == pytest.approx(0.95, abs=0.03)
    with pytest.raises(ValueError, match="expected those of one frame"):
        counts_per_frame([], edges)
