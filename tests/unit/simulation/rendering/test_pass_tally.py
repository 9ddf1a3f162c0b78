"""Passes of pixels: their errors, and how many they get."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sabench.simulation.rendering.bubbles_traced import STREAMS, PassTally
from sabench.utils.arrays import F64

_ALL = np.ones((2, 2), dtype=np.bool_)


def _run(tally: PassTally, scatter: F64, error: float) -> F64:
    """Add passes with the scatter (n,) until the error is reached; returns the errors."""
    random, more = np.random.default_rng(1), np.full(len(scatter), STREAMS)
    while more.any():
        chosen = np.flatnonzero(more)
        values = 1.0 + np.repeat(scatter[chosen], more[chosen]) * random.normal(size=more.sum())
        tally.add(chosen, more[chosen], values)
        off = tally.errors(0.1)
        more = tally.wanted(off, error) - tally.count
    return off


def test_pixels_with_larger_errors_get_more_rays() -> None:
    """The mean error is reached with most rays where bubbles are."""
    tally = PassTally(np.ones((20, 20), dtype=np.bool_))
    off = _run(tally, np.where(np.arange(400) < 40, 0.5, 0.002), 0.008)
    assert 0.006 < off.mean() <= 0.008
    assert tally.count[:20].mean() > 10.0 * tally.count[200:].mean()
    assert np.abs(tally.mean - 1.0).mean() < 0.01


def test_an_even_background_does_not_excuse_errors_of_what_is_shown() -> None:
    """The mean is over the pixels that count, and others do not take more rays than they need."""
    counted = np.zeros((40, 40), dtype=np.bool_)
    counted[:2] = True
    tally = PassTally(counted)
    off = _run(tally, np.where(counted.ravel(), 0.5, 0.02), 0.02)
    shown = off[counted.ravel()].mean()
    assert tally.mean_error(off) == shown
    assert 0.015 < shown <= 0.02
    assert tally.count[400:].mean() < 1.5 * STREAMS


def test_an_image_that_shows_nothing_is_done_at_once() -> None:
    """Nothing counts, and there is no mean to reach."""
    tally = PassTally(~_ALL)
    assert tally.mean_error(_run(tally, np.full(4, 0.5), 1e-3)) == 0.0
    assert tally.count.max() == STREAMS


def test_passes_that_come_in_parts_have_the_mean_and_scatter_of_all() -> None:
    """As if all had come at once, also if pixels get different numbers."""
    values = np.random.default_rng(2).normal(5.0, 1.0, size=(4, 12))
    parts, whole = PassTally(_ALL), PassTally(_ALL)
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
    tally, streams = PassTally(_ALL[:1, :1]), np.array([1.0, 2.0, 3.0, 6.0])
    tally.add(np.array([0]), np.array([8]), np.concatenate([streams - 0.5, streams + 0.5]))
    expected = streams.std(ddof=1) / math.sqrt(STREAMS) / streams.mean()
    assert tally.errors(0.0)[0] == pytest.approx(expected)
