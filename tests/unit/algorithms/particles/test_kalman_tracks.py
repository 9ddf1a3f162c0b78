"""Tracks predict what moves steadily, and learn how far it does not."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.kalman_tracks import KalmanTracks
from sabench.utils.arrays import F64

STEP, ERROR = 0.01, 0.002  # s, mm
COUNT = 400


def begin(position: F64, velocity: F64, spread: float, acceleration: float) -> KalmanTracks:
    """Tracks that have been seen once."""
    tracks = KalmanTracks.start(acceleration, 0.1 * acceleration / STEP)
    variance, light = np.full(position.shape, ERROR**2), np.ones((len(position), 4))
    speeds = np.full(position.shape, spread**2)
    tracks.add(np.arange(len(position)), position, variance, light, velocity, speeds, 1)
    return tracks


def follow(tracks: KalmanTracks, positions: F64) -> list[F64]:
    """Misses of the predictions of positions (frame, n, 3), over the errors expected."""
    rows, out = np.arange(len(tracks.number)), []
    variance = np.full(positions[0].shape, ERROR**2)
    for position in positions:
        tracks.predict(STEP)
        out.append(tracks.off(rows, position, variance))
        tracks.update(rows, position, variance, tracks.light)
    return out


def test_steady_acceleration_is_predicted() -> None:
    rng = np.random.default_rng(1)
    start, velocity, acceleration = rng.normal(size=(3, 50, 3)) * [[[5.0]], [[10.0]], [[100.0]]]
    times = STEP * np.arange(1, 12)[:, None, None]
    path = start + velocity * times + 0.5 * acceleration * times**2
    tracks = begin(start, velocity, 5.0, 100.0**2)
    follow(tracks, path[:-1])
    tracks.predict(STEP)
    np.testing.assert_allclose(tracks.state[:, 0], path[-1], atol=ERROR)
    np.testing.assert_allclose(tracks.state[:, 2], acceleration, atol=10.0)


@pytest.mark.parametrize("guess", [0.01, 100.0])
def test_the_strength_of_the_jerk_is_learned(guess: float) -> None:
    """Misses are as large as expected, whatever the first guess of the acceleration was."""
    rng = np.random.default_rng(2)
    state = np.zeros((COUNT, 3, 3))
    state[:, 1], state[:, 2] = rng.normal(0.0, 10.0, (2, COUNT, 3))
    power, fine, path = 5e5, 20, []
    for _ in range(40):
        for _ in range(fine):  # a random jerk by many small kicks
            h = STEP / fine
            state[:, 0] += h * state[:, 1]
            state[:, 1] += h * state[:, 2]
            state[:, 2] += np.sqrt(power * h) * rng.normal(size=(COUNT, 3))
        path.append(state[:, 0] + ERROR * rng.normal(size=(COUNT, 3)))
    tracks = begin(np.zeros((COUNT, 3)), np.zeros((COUNT, 3)), 10.0, guess * 100.0)
    misses = follow(tracks, np.array(path))
    assert np.mean(misses[-10:]) == pytest.approx(1.0, abs=0.25)
    assert tracks.jerk == pytest.approx(power, rel=0.5)


def test_a_surprised_track_recovers_at_once() -> None:
    tracks = begin(np.zeros((COUNT, 3)), np.zeros((COUNT, 3)), 0.1, 1.0)
    follow(tracks, np.zeros((10, COUNT, 3)))
    turned = np.zeros((4, COUNT, 3))
    turned[:, 0, 0] = 0.1 * np.arange(1, 5)  # one particle is hit
    misses = follow(tracks, turned)
    assert misses[0][0, 0] > 100.0
    assert misses[-1][0, 0] < 12.0
    assert np.max(misses[-1][1:]) < 1.0


def test_a_new_track_moves_as_its_neighbours_do() -> None:
    rng = np.random.default_rng(3)
    place = rng.uniform(-5.0, 5.0, (COUNT, 3))
    velocity = np.stack([place[:, 1], -place[:, 0], np.full(COUNT, 2.0)], axis=1)  # a vortex
    tracks = begin(place, velocity, 0.1, 1.0)
    assert (tracks.neighbours_velocity(place[:5])[1] > 1e6).all()  # nothing known yet
    follow(tracks, (place + STEP * velocity)[None])
    points = np.array([[1.0, 2.0, 0.0], [-3.0, 0.5, 1.0]])
    found, spread = tracks.neighbours_velocity(points)
    expected = np.stack([points[:, 1], -points[:, 0], np.full(2, 2.0)], axis=1)
    np.testing.assert_allclose(found, expected, atol=1.0)
    assert (spread[:, :2] > 0.01).all()
    assert (spread[:, 2] < 0.02).all()
