"""First guesses of how particles accelerate, from velocities in one instant."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.kalman_tracks import start_tracks
from sabench.utils.arrays import F64


def flow(position: F64, wavelength: float, speed: float) -> tuple[F64, F64]:
    """Velocities (n, 3) of random waves, divergence-free, and accelerations (u grad) u."""
    rng = np.random.default_rng(3)
    velocity, slopes = np.zeros_like(position), np.zeros((len(position), 3, 3))
    for _ in range(60):
        wave, phase = rng.standard_normal(3) * 2.0 * np.pi / wavelength, rng.uniform(0.0, 6.28)
        along = np.cross(wave, rng.standard_normal(3))
        along *= speed / np.linalg.norm(along) / 5.0
        angle = position @ wave + phase
        velocity += np.cos(angle)[:, None] * along
        slopes -= np.sin(angle)[:, None, None] * along[:, None] * wave
    return velocity, np.einsum("nab,nb->na", slopes, velocity)


def guess(count: int, wavelength: float, speed: float) -> tuple[float, float]:
    """Guessed and true standard deviation of an acceleration's components."""
    position = np.random.default_rng(5).uniform(0.0, 10.0, (count, 3))
    velocity, true = flow(position, wavelength, speed)
    tracks = start_tracks(position, velocity, 0.01, 1e-9)
    return float(np.sqrt(tracks.acceleration)), float(np.sqrt(np.mean(true**2)))


@pytest.mark.parametrize(("wavelength", "speed"), [(8.0, 3.0), (20.0, 3.0), (8.0, 12.0)])
def test_accelerations_are_guessed_from_velocities_and_their_gradient(
    wavelength: float, speed: float
) -> None:
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
