"""Scores of a code's reading."""

import numpy as np
import pytest

from sabench.metrics.code_reading import otsu, reading


def test_a_clear_picture_is_read_whole() -> None:
    dark = np.arange(40) % 2 == 0
    scores = reading(np.where(dark, 0.2, 0.8), dark)
    assert scores["read_percent"] == 100.0
    assert scores["contrast"] == pytest.approx(0.6)
    assert scores["separation"] > 1e6


def test_noise_is_read_as_the_normal_law_says() -> None:
    """Two normal clouds d' apart are separated with the probability Phi(d' / 2)."""
    from scipy.stats import norm

    rng = np.random.default_rng(2)
    dark = rng.permutation(40_000) < 20_000
    scores = reading(np.where(dark, 0.0, 2.0) + rng.standard_normal(40_000), dark)
    assert scores["separation"] == pytest.approx(2.0, abs=0.03)
    assert scores["read_percent"] == pytest.approx(100.0 * norm.cdf(1.0), abs=0.6)


def test_a_negative_is_read_wrong_and_what_is_not_shown_is_not_read() -> None:
    dark = np.arange(40) % 2 == 0
    clear = np.where(dark, 0.2, 0.8)
    assert reading(1.0 - clear, dark)["read_percent"] == 0.0
    clear[:10] = np.nan
    assert reading(clear, dark)["read_percent"] == 75.0
    assert reading(np.full(40, np.nan), dark)["read_percent"] == 0.0
    assert reading(np.zeros(40), dark)["read_percent"] == 50.0


def test_otsu_parts_two_groups() -> None:
    values = np.random.default_rng(3).normal(size=50) + np.repeat([0.0, 3.0], [20, 30])

    def between(level: float) -> float:
        low, high = values[values < level], values[values >= level]
        return float(len(low) * len(high) * (low.mean() - high.mean()) ** 2)

    ordered = np.sort(values)
    every = (ordered[1:] + ordered[:-1]) / 2.0
    assert between(otsu(values)) == pytest.approx(max(between(level) for level in every))
