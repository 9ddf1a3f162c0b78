"""Predictions of tracks, first guesses of accelerations, and most probable motion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.particles.kalman_tracks import (
    KalmanTracks,
    most_probable_motion,
    start_tracks,
)
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
    assert_allclose(tracks.state[:, 0], path[-1], atol=ERROR)
    assert_allclose(tracks.state[:, 2], acceleration, atol=10.0)


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
    assert np.mean(follow(tracks, np.array(path))[-10:]) == pytest.approx(1.0, abs=0.25)
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
    place = np.random.default_rng(3).uniform(-5.0, 5.0, (COUNT, 3))
    velocity = np.stack([place[:, 1], -place[:, 0], np.full(COUNT, 2.0)], axis=1)  # a vortex
    tracks = begin(place, velocity, 0.1, 1.0)
    assert (tracks.neighbours_velocity(place[:5])[1] > 1e6).all()  # nothing known yet
    follow(tracks, (place + STEP * velocity)[None])
    points = np.array([[1.0, 2.0, 0.0], [-3.0, 0.5, 1.0]])
    found, spread = tracks.neighbours_velocity(points)
    expected = np.stack([points[:, 1], -points[:, 0], np.full(2, 2.0)], axis=1)
    assert_allclose(found, expected, atol=1.0)
    assert (spread[:, :2] > 0.01).all()
    assert (spread[:, 2] < 0.02).all()


_TIMES = 1e-3 * np.arange(-3.0, 4.0)
_WIDE = 1e18


def _estimate(position: F64, variance: F64, times: F64 = _TIMES, jerk: float = 0.0) -> F64:
    still = np.zeros((len(position), 3))
    wide = np.full(still.shape, _WIDE)
    return most_probable_motion(times, position, variance, still, wide, _WIDE, jerk)[0]


def test_a_parabola_is_found_exactly() -> None:
    state = np.array([[50.0, -20.0, 3.0], [120.0, 40.0, -70.0], [3e3, -9e3, 1e3]])
    position = (np.stack([np.ones(7), _TIMES, _TIMES**2 / 2.0], axis=1) @ state)[None]
    assert_allclose(_estimate(position, np.full((1, 7, 3), 1e-4), jerk=1e3)[0], state, rtol=1e-6)


def test_positions_that_are_not_there_do_not_count() -> None:
    rng = np.random.default_rng(3)
    position, variance = rng.normal(size=(5, 7, 3)), rng.uniform(0.5, 2.0, size=(5, 7, 3))
    kept = np.array([0, 1, 3, 4, 6])
    part = _estimate(position[:, kept], variance[:, kept], _TIMES[kept], 1e9)
    position[:, [2, 5]] = np.nan
    assert_allclose(_estimate(position, variance, jerk=1e9), part, rtol=1e-6)


@pytest.mark.parametrize("jerk", [1e2, 1e6])
def test_errors_are_as_large_as_claimed(jerk: float) -> None:
    """Bodies are moved by many small random jerks, whose sums are no formula of the estimate."""
    rng = np.random.default_rng(5)
    count, steps, noise, acceleration = 3000, 300, 0.01, 2e3
    step = 6e-3 / steps
    state = np.zeros((count, 3, 3))
    state[:, 1] = rng.normal(scale=50.0, size=(count, 3))
    state[:, 2] = rng.normal(scale=acceleration, size=(count, 3))
    at, states = range(0, steps + 1, steps // 6), []
    for number in range(steps + 1):
        if number in at:
            states.append(state.copy())
        state[:, 0] += step * state[:, 1] + step**2 / 2.0 * state[:, 2]
        state[:, 1] += step * state[:, 2]
        state[:, 2] += rng.normal(scale=np.sqrt(jerk / step) * step, size=(count, 3))
    path = np.stack(states, axis=1)
    seen = path[:, :, 0] + rng.normal(scale=noise, size=(count, 7, 3))
    known = (np.full((count, 7, 3), noise**2), np.zeros((count, 3)), np.full((count, 3), 50.0**2))
    state, covariance = most_probable_motion(_TIMES, seen, *known, acceleration**2, jerk)
    error = (state - path[:, 3]).transpose(0, 2, 1)
    squares = np.einsum("nap,napq,naq->na", error, np.linalg.inv(covariance), error)
    assert squares.mean() == pytest.approx(3.0, abs=0.15)


def test_a_single_position_moves_as_it_is_expected_to() -> None:
    position = np.full((1, 7, 3), np.nan)
    position[0, 3] = [1.0, 2.0, 3.0]
    velocity, spread = np.array([[10.0, 20.0, 30.0]]), np.full((1, 3), 4.0)
    state, covariance = most_probable_motion(
        _TIMES, position, np.full((1, 7, 3), 1e-4), velocity, spread, 9.0, 1.0
    )
    assert_allclose(state[0], [[1.0, 2.0, 3.0], [10.0, 20.0, 30.0], [0.0] * 3], atol=1e-6)
    assert_allclose(covariance[0, 0].diagonal(), [1e-4, 4.0, 9.0], rtol=1e-6)


def guess(count: int, wavelength: float, speed: float) -> tuple[float, float]:
    """Guessed and true standard deviation of an acceleration's components."""
    position = np.random.default_rng(5).uniform(0.0, 10.0, (count, 3))
    rng, velocity, slopes = np.random.default_rng(3), np.zeros((count, 3)), np.zeros((count, 3, 3))
    for _ in range(60):  # random waves, free of divergence
        wave, phase = rng.standard_normal(3) * 2.0 * np.pi / wavelength, rng.uniform(0.0, 6.28)
        along = np.cross(wave, rng.standard_normal(3))
        along *= speed / np.linalg.norm(along) / 5.0
        angle = position @ wave + phase
        velocity += np.cos(angle)[:, None] * along
        slopes -= np.sin(angle)[:, None, None] * along[:, None] * wave
    true = np.einsum("nab,nb->na", slopes, velocity)
    tracks = start_tracks(position, velocity, 0.01, 1e-9)
    return float(np.sqrt(tracks.acceleration)), float(np.sqrt(np.mean(true**2)))


@pytest.mark.parametrize(("wavelength", "speed"), [(8.0, 3.0), (20.0, 3.0), (8.0, 12.0)])
def test_accelerations_are_guessed_from_velocities(wavelength: float, speed: float) -> None:
    """Not from the distance of particles: with four times as many it is the same."""
    few, true = guess(2000, wavelength, speed)
    many, _ = guess(8000, wavelength, speed)
    assert few == pytest.approx(1.4 * true, rel=0.35)  # turbulence itself changes, too
    assert many == pytest.approx(few, rel=0.15)


def test_particles_that_stand_still_get_the_least_acceleration() -> None:
    position = np.random.default_rng(5).uniform(0.0, 10.0, (50, 3))
    tracks = start_tracks(position, np.zeros((50, 3)), 0.01, 0.5)
    assert tracks.acceleration == pytest.approx(0.25)
    assert np.isfinite(tracks.jerk)
    assert tracks.jerk >= 0.0
