"""Scores of one frame: best and worst, both rules, and weights of particles that cameras miss."""

import numpy as np
import pytest

from sabench.api import Reconstruction
from sabench.api.truth import ParticleView
from sabench.metrics.reconstruction_error import brightness, score_frame, true_field
from sabench.simulation.in_memory import Shot, simulate
from sabench.tasks.reconstruction import TASK
from tests.helpers.particle_scenes import cloud, make_scene


@pytest.fixture(scope="module")
def shot() -> Shot:
    return simulate(make_scene(particles={"count": 150}), seed=7)


def scores_of(shot: Shot, guess: Reconstruction) -> dict[str, float | None]:
    return score_frame(shot.observation.grid, shot.particles, shot.views, guess)


def test_truth_is_perfect_and_empty_is_the_floor_by_both_rules(shot: Shot) -> None:
    field = true_field(shot.observation.grid, shot.particles, shot.views)
    best = scores_of(shot, Reconstruction(field, shot.particles.position_mm))
    floor = scores_of(shot, Reconstruction(np.zeros_like(field)))
    assert tuple(best) == tuple(floor) == tuple(score.key for score in TASK.scores)
    for rule in ("", "peak_"):
        shares = ("true_percent", "ghost_percent", "precision", "recall", "rms_px")
        keys = [rule + key for key in shares]
        assert [best[key] for key in keys] == [100.0, 0.0, 1.0, 1.0, 0.0]
        assert [floor[key] for key in keys] == [0.0, 0.0, 0.0, 0.0, None]
    assert best["q"] == pytest.approx(1.0, abs=1e-6)
    assert best["peak_f1"] == 1.0
    assert best["intensity_error"] == pytest.approx(0.0, abs=0.01)
    assert (floor["q"], floor["peak_f1"], floor["intensity_error"]) == (0.0, 0.0, 1.0)


def test_peaks_tell_particles_apart_that_are_one_component(shot: Shot) -> None:
    grid = shot.observation.grid
    places = np.column_stack([np.arange(30.0, 60.0, 3.0), np.full(10, 50.0), np.full(10, 10.0)])
    particles = cloud(np.asarray(grid.low_mm) + places * grid.voxel_mm)
    views = [ParticleView(np.zeros((10, 2)), np.ones(10), np.full(10, 0.8), np.ones(10, bool))]
    found = score_frame(grid, particles, views, Reconstruction(true_field(grid, particles, views)))
    assert found["recall"] == pytest.approx(0.0)
    assert found["peak_recall"] == found["peak_precision"] == pytest.approx(1.0)


BRIGHTNESS = [
    ([[1.0, 2.0, 3.0], [30.0, 20.0, 10.0]], [1.0, 1.0, 1.0]),
    ([[1.0, 3.0], [1.0, 3.0]], [0.5, 1.5]),
    ([[1.0, 0.0, 3.0], [2.0, 0.0, 6.0]], [0.5, 0.0, 1.5]),  # one outside the light
    ([[1.0, 3.0, 2.0], [0.0, 0.0, 0.0]], [0.5, 1.5, 1.0]),  # a covered camera
    ([[2.0, 2.0, 2.0], [0.0, 2.0, 2.0]], [1.0, 1.0, 1.0]),  # one hidden from a camera
    ([[0.0, 0.0], [0.0, 0.0]], [0.0, 0.0]),
]


def test_brightness_is_relative_to_each_camera_and_the_mean_of_those_that_see() -> None:
    for photons, expected in BRIGHTNESS:
        views = []
        for row in photons:
            one, seen = np.ones(len(row)), np.ones(len(row), dtype=np.bool_)
            views.append(ParticleView(np.zeros((len(row), 2)), np.array(row), one, seen))
        np.testing.assert_allclose(brightness(views), expected)
