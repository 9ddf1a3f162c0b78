"""Scores beside Q that do not depend on the shape of blobs."""

import numpy as np
import pytest

from sabench.api import Reconstruction
from sabench.api.truth import Particles, ParticleView
from sabench.geometry.grid import Grid, synthesise
from sabench.metrics.particle_detection import detect_peaks
from sabench.metrics.reconstruction_error import (
    _find_steps,
    blob_intensities,
    intensity_error,
    score_frame,
)
from sabench.utils.arrays import F32, F64, triple

GRID = Grid((-5.0, -4.0, 0.0), (0.05, 0.05, 0.1), (40, 160, 200), (10, 10, 0))
SIGMA_PX = 0.48  # given by the lens of the standard scenes
SHAPES = [(0.5, 1.0), (1.5, 1.0), (1.0, 2.0), (1.0, 3.0)]


def particles() -> tuple[Particles, F64]:
    """Make particles spread over all of the volume, with a brightness of .5 to 1.5."""
    rng, size = np.random.default_rng(1), np.asarray(GRID.voxel_mm) * GRID.shape[::-1]
    place = np.asarray(GRID.low_mm) + rng.random((250, 3)) * size
    made = Particles(np.arange(250), place, np.full(250, 0.02), np.zeros((250, 3)))
    return made, rng.uniform(0.5, 1.5, 250)


def volume(true: Particles, weights: F64, wide: float = 1.0, long: float = 1.0) -> F32:
    """Synthesise blobs so many times as wide, and so many times as long along z."""
    shrunk = np.array([1.0, 1.0, 1.0 / long])
    grid = Grid(triple(GRID.low_mm * shrunk), triple(GRID.voxel_mm * shrunk), GRID.shape, GRID.crop)
    return synthesise(grid, true.position_mm * shrunk, weights, wide * SIGMA_PX * GRID.voxel_mm[0])


def scores(guess: F32) -> dict[str, float | None]:
    true, weights = particles()
    view = ParticleView(
        np.zeros((250, 2)), weights, np.full(250, SIGMA_PX), np.ones(250, dtype=np.bool_)
    )
    return score_frame(GRID, true, [view], Reconstruction(guess))


def test_q_ranks_the_shape_of_blobs_of_an_exact_reconstruction() -> None:
    """The figures of docs/tasks/reconstruction.md."""
    true, weights = particles()
    half, long = scores(volume(true, weights, 0.5)), scores(volume(true, weights, 1.0, 3.0))
    assert half["q"] == pytest.approx(0.928, abs=0.005)
    assert long["q"] == pytest.approx(0.901, abs=0.01)


@pytest.mark.parametrize(("wide", "long"), SHAPES)
def test_the_shape_of_blobs_does_not_count(wide: float, long: float) -> None:
    true, weights = particles()
    exact, other = scores(volume(true, weights)), scores(volume(true, weights, wide, long))
    assert exact["peak_f1"] == pytest.approx(1.0, abs=0.01)
    assert other["peak_f1"] == pytest.approx(exact["peak_f1"], abs=0.01)
    assert exact["intensity_error"] == pytest.approx(0.0, abs=0.01)
    assert other["intensity_error"] == pytest.approx(exact["intensity_error"], abs=0.01)


def test_ghosts_and_lost_particles_lower_f1() -> None:
    true, weights = particles()
    lost = np.where(np.arange(250) < 50, 0.0, weights)
    found = scores(volume(true, lost))
    assert found["peak_f1"] == pytest.approx(2 / (1 + 1 / 0.8), abs=0.02)
    assert found["intensity_error"] == pytest.approx(np.sqrt(0.2), abs=0.05)
    exact = volume(true, weights)
    ghosts = np.maximum(exact, np.roll(volume(true, 0.5 * lost), (7, 23, 31), axis=(0, 1, 2)))
    assert scores(np.asarray(ghosts))["peak_f1"] == pytest.approx(2 / (1 + 1.8), abs=0.02)


def test_blobs_hold_all_the_light_that_leads_to_their_peak() -> None:
    one = Particles(np.arange(1), np.array([[0.01, 0.02, 2.03]]), np.ones(1), np.zeros((1, 3)))
    blob = volume(one, np.array([3.0]), 1.5, 3.0)
    peaks = detect_peaks(blob)
    assert blob_intensities(blob, peaks) == pytest.approx([blob.sum()], rel=1e-5)
    truth, yes = GRID.to_voxels(one.position_mm), np.ones(1, dtype=np.bool_)
    assert intensity_error(blob, peaks, truth, np.ones(1), yes) == pytest.approx(0.0, abs=1e-6)
    assert intensity_error(blob, peaks, truth, np.zeros(1), yes) is None


def test_steps_lead_to_the_brightest_neighbour_up_to_the_faces() -> None:
    """Against a loop over all 27, for a volume so small that every voxel is near a face."""
    bright = np.random.default_rng(3).random((3, 4, 5)).astype(np.float32)
    step = _find_steps(bright)
    padded = np.pad(bright, 1, constant_values=-1.0)
    for place in np.ndindex(*bright.shape):
        assert step[place] == int(padded[tuple(slice(one, one + 3) for one in place)].argmax())
