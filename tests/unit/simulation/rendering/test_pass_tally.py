"""Passes of pixels: their errors, and how many they get."""

from __future__ import annotations

import numpy as np

from sabench.simulation.rendering.pass_tally import PassTally


def test_pixels_with_larger_errors_get_more_rays() -> None:
    """The mean error is reached with most rays where bubbles are."""
    random, tally = np.random.default_rng(1), PassTally((20, 20))
    scatter = np.where(np.arange(400) < 40, 0.5, 0.01)
    more = np.full(400, 4)
    while more.any():
        chosen = np.flatnonzero(more)
        values = 1.0 + np.repeat(scatter[chosen], more[chosen]) * random.normal(size=more.sum())
        tally.add(chosen, more[chosen], values)
        off = tally.errors(0.1)
        more = tally.wanted(off, 0.01) - tally.count
    assert 0.008 < off.mean() <= 0.01
    assert tally.count[:20].mean() > 10.0 * tally.count[200:].mean()
    assert np.abs(tally.mean - 1.0).mean() < 0.01


def test_passes_that_come_in_parts_have_the_mean_and_scatter_of_all() -> None:
    """As if all had come at once, also if pixels get different numbers."""
    values = np.random.default_rng(2).normal(5.0, 1.0, size=(4, 10))
    parts, whole = PassTally((2, 2)), PassTally((2, 2))
    pixels = np.arange(4)
    parts.add(pixels, np.full(4, 3), values[:, :3].ravel())
    parts.add(pixels[1:], np.full(3, 7), values[1:, 3:].ravel())
    parts.add(pixels[:1], np.array([7]), values[0, 3:])
    whole.add(pixels, np.full(4, 10), values.ravel())
    np.testing.assert_allclose(parts.mean, values.mean(axis=1))
    np.testing.assert_allclose(parts.errors(0.0), whole.errors(0.0))
    np.testing.assert_array_equal(parts.count, 10)
