"""Starts of tracks among as many ghosts as particles."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sabench.algorithms.particles import dense_start
from sabench.utils.arrays import F64

BOX, CLOUD, STEP = 6.0, 2000, 0.01  # mm, particles, s
DISTANCE = BOX / CLOUD ** (1.0 / 3.0)
NOISE = 0.04 * DISTANCE
SPEED = 0.35 * DISTANCE / STEP  # mm/s
TIMES = STEP * np.arange(6)


def velocity_of(position: F64) -> F64:
    """A flow that turns over a few distances between particles."""
    phase = position[:, [1, 2, 0]] * 2.0 * np.pi / BOX + np.arange(3.0)
    return np.asarray(SPEED * (1.0 + np.sin(phase)))


def find(position: F64, seed: int, share: float = 0.6) -> F64:
    """Part of the particles (n, 3), with errors, and as many ghosts."""
    rng = np.random.default_rng([4, seed])
    seen = position[rng.random(len(position)) < share]
    ghosts = rng.uniform(0.0, BOX, seen.shape)
    return np.concatenate([seen + NOISE * rng.standard_normal(seen.shape), ghosts])


@pytest.fixture(scope="module")
def truth() -> list[F64]:
    positions = [np.random.default_rng(3).uniform(0.0, BOX, (CLOUD, 3))]
    for _ in TIMES[1:]:
        position = positions[-1]
        for _ in range(5):
            position = position + STEP / 5.0 * velocity_of(position)
        positions.append(position)
    return positions


@pytest.fixture(scope="module")
def frames(truth: list[F64]) -> list[dense_start.Finds]:
    found = [find(position, number) for number, position in enumerate(truth)]
    return [
        dense_start.Finds(float(time), one, np.full(one.shape, NOISE**2), np.ones((len(one), 4)))
        for time, one in zip(TIMES, found, strict=True)
    ]


def distances(position: F64, truth: F64) -> F64:
    return np.asarray(cKDTree(truth).query(position)[0])


@pytest.mark.slow
def test_confirmed_particles_are_real(frames: list[dense_start.Finds], truth: list[F64]) -> None:
    """Of what is found in a frame, half is real; of what several frames show, nearly all is."""
    for slot, known in enumerate(dense_start.confirm_tracks(frames, DISTANCE)):
        off = distances(known.position, truth[slot])
        assert len(off) > 0.35 * CLOUD
        assert known.light.shape == (len(off), 4)
        between = 0 < slot < len(frames) - 2
        assert (off < 4.0 * NOISE).mean() > (0.85 if between else 0.6)
        assert (distances(frames[slot].position, truth[slot]) < 4.0 * NOISE).mean() < 0.55


@pytest.mark.slow
def test_velocities_come_from_wrong_links(
    frames: list[dense_start.Finds], truth: list[F64]
) -> None:
    votes = dense_start.collect_votes([f.position for f in frames], [f.time for f in frames])
    wrong = np.linalg.norm(votes.velocity - velocity_of(votes.position), axis=1) > 0.5 * SPEED
    assert wrong.mean() > 0.4
    velocity, variance = dense_start.estimate_velocity(votes, truth[2], DISTANCE)
    assert np.median(np.linalg.norm(velocity - velocity_of(truth[2]), axis=1)) < 0.2 * SPEED
    assert (variance > 0.0).all()


def test_links_are_wrong_where_they_differ_from_those_around() -> None:
    rng = np.random.default_rng(5)
    position = rng.uniform(0.0, BOX, (500, 3))
    shift = STEP * velocity_of(position)
    assert not dense_start.are_mostly_wrong(position, shift)
    shift[::3] = rng.uniform(-DISTANCE, DISTANCE, shift[::3].shape)
    assert dense_start.are_mostly_wrong(position, shift)
    assert not dense_start.are_mostly_wrong(position[:5], rng.standard_normal((5, 3)))
