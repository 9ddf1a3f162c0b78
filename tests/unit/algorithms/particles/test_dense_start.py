"""Starts of tracks among ghosts: what moves as the flow does, in several frames, is real."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.dense_start import (
    Finds,
    LinkVotes,
    are_mostly_wrong,
    confirm_tracks,
    estimate_velocity,
)
from sabench.utils.arrays import F64

COUNT, FRAMES, INTERVAL, ERROR = 800, 6, 0.01, 0.01
SPACING = (1000.0 / COUNT) ** (1.0 / 3.0)  # of particles in a cube of 10 mm


def flow(position: F64) -> F64:
    """A rotation with shear, mm/s: 0.3 mm in an interval."""
    x, y, z = position.T
    return np.stack([20.0 - 4.0 * y, 4.0 * x, 10.0 + 2.0 * z], axis=1)


def test_links_that_scatter_are_wrong_and_those_of_a_flow_are_not() -> None:
    rng = np.random.default_rng(4)
    position = rng.uniform(0.0, 10.0, (COUNT, 3))
    shift = INTERVAL * flow(position) + ERROR * rng.standard_normal((COUNT, 3))
    assert not are_mostly_wrong(position, shift)
    wrong = rng.random(COUNT) < 0.4
    shift[wrong] = rng.uniform(-1.5, 1.5, (wrong.sum(), 3))
    assert are_mostly_wrong(position, shift)


def test_the_flow_is_found_among_wrong_links() -> None:
    rng = np.random.default_rng(5)
    position = rng.uniform(0.0, 10.0, (4 * COUNT, 3))
    velocity = flow(position)
    wrong = rng.random(len(position)) < 0.6
    velocity[wrong] = rng.uniform(-150.0, 150.0, (wrong.sum(), 3))
    votes = LinkVotes(position, velocity, np.zeros(len(position)), INTERVAL, INTERVAL)
    here = rng.uniform(2.0, 8.0, (100, 3))
    found, variance = estimate_velocity(votes, here, 0.0, SPACING)
    off = np.linalg.norm(found - flow(here), axis=1)
    assert np.median(off) < 2.0  # of 20 to 50 mm/s
    assert np.mean(off < 10.0) > 0.95
    assert np.all(variance > 0.0)


@pytest.mark.slow
def test_tracks_through_several_frames_are_real() -> None:
    """Of as many ghosts as particles, hardly any is confirmed."""
    rng = np.random.default_rng(6)
    position, frames, true = rng.uniform(0.0, 10.0, (COUNT, 3)), [], []
    for number in range(FRAMES):
        ghosts = rng.uniform(0.0, 10.0, (COUNT, 3))
        seen = rng.random(COUNT) < 0.9
        found = np.concatenate(
            [position[seen] + ERROR * rng.standard_normal((seen.sum(), 3)), ghosts]
        )
        variance, light = np.full_like(found, ERROR**2), np.ones((len(found), 4))
        frames.append(Finds(INTERVAL * number, found, variance, light))
        true.append(position)
        position = position + INTERVAL * flow(position)
    known = confirm_tracks(frames, SPACING)
    for one, there in zip(known, true, strict=True):
        off = np.linalg.norm(one.position[:, None] - there[None], axis=2)
        assert np.mean(off.min(axis=1) < 6.0 * ERROR) > 0.95
        assert np.mean(off.min(axis=0) < 6.0 * ERROR) > 0.6
