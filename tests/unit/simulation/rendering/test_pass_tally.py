"""Passes of pixels: their errors, and how many they get."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sabench.simulation.rendering.pass_tally import STREAMS, PassTally


def test_pixels_with_larger_errors_get_more_rays() -> None:
    """The mean error is reached with most rays where bubbles are."""
    random, tally = np.random.default_rng(1), PassTally((20, 20))
    scatter = np.where(np.arange(400) < 40, 0.5, 0.002)
    more = np.full(400, 4)
    while more.any():
        chosen = np.flatnonzero(more)
        values = 1.0 + np.repeat(scatter[chosen], more[chosen]) * random.normal(size=more.sum())
        tally.add(chosen, more[chosen], values)
        off = tally.errors(0.1)
        more = tally.wanted(off, 0.008) - tally.count
    assert 0.006 < off.mean() <= 0.008
    assert tally.count[:20].mean() > 10.0 * tally.count[200:].mean()
    assert np.abs(tally.mean - 1.0).mean() < 0.01


def test_passes_that_come_in_parts_have_the_mean_and_scatter_of_all() -> None:
    """As if all had come at once, also if pixels get different numbers."""
    values = np.random.default_rng(2).normal(5.0, 1.0, size=(4, 12))
    parts, whole = PassTally((2, 2)), PassTally((2, 2))
    pixels = np.arange(4)
    parts.add(pixels, np.full(4, 4), values[:, :4].ravel())
    parts.add(pixels[1:], np.full(3, 8), values[1:, 4:].ravel())
    parts.add(pixels[:1], np.array([8]), values[0, 4:])
    whole.add(pixels, np.full(4, 12), values.ravel())
    np.testing.assert_allclose(parts.mean, values.mean(axis=1))
    np.testing.assert_allclose(parts.errors(0.0), whole.errors(0.0))
    np.testing.assert_array_equal(parts.count, 12)


def test_errors_are_those_of_the_means_of_streams() -> None:
    """Passes that take turns belong to one stream each."""
    tally, streams = PassTally((1, 1)), np.array([1.0, 2.0, 3.0, 6.0])
    tally.add(np.array([0]), np.array([8]), np.concatenate([streams - 0.5, streams + 0.5]))
    expected = streams.std(ddof=1) / math.sqrt(STREAMS) / streams.mean()
    assert tally.errors(0.0)[0] == pytest.approx(expected)
