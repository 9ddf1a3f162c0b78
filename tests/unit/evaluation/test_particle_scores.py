"""Scores of the benchmark of particle density against those of the task `particles`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.particle_density import CASES, scene_of
from benchmarks.particle_scores import Recording, find_particles, score_particles
from sabench.api import FoundParticles
from sabench.api.make import make_algorithm
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.simulation.in_memory import simulate
from sabench.simulation.pipeline import generate
from sabench.tasks.particles import score_frame


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Four cameras in water behind glass; the sides are unequal everywhere."""
    values = load_scene("quick").to_dict()
    values["volume"]["size_mm"] = [9.0, 6.0, 3.0]
    values["particles"]["count"] = 120
    return parse_scene(values, "small")


def test_scores_are_those_of_the_task(scene: Scene, tmp_path: Path) -> None:
    data = generate(scene, tmp_path / "data", seed=4, backend="splat")
    shot = simulate(scene, seed=4)
    rng = np.random.default_rng(5)
    root = 0.003 * rng.normal(size=(3, 3)) + 0.01 * np.eye(3)
    true = shot.particles.position_mm[10:]
    found = FoundParticles(
        np.concatenate([true + rng.normal(size=true.shape) @ root.T, true[:7] + 0.7]),
        covariance_mm2=np.broadcast_to(root @ root.T, (len(true) + 7, 3, 3)),
    )
    own = score_particles(
        found, shot, build_rig(scene).cameras, Recording(shot.observation.images, scene.sensor)
    )
    task = score_frame(data, found, shot.particles, 0)
    assert own["recall"] == pytest.approx(100.0 * float(task["recall"] or 0.0), abs=0.01)
    for key, digits in (("f1", 4), ("rms_px", 4), ("coverage_68", 3), ("coverage_95", 3)):
        assert own[key] == round(float(task[key] or 0.0), digits), key
    assert own["rms_over_bound"] == pytest.approx(task["rms_over_bound"], rel=1e-3)


def test_particles_of_a_volume_are_its_maxima(scene: Scene) -> None:
    shot = simulate(scene, seed=4)
    found = find_particles(make_algorithm("msa", {}), shot.observation)
    scores = score_particles(found, shot, build_rig(scene).cameras, None)
    assert scores["recall"] > 80.0
    assert scores["rms_px"] < 0.5
    assert "rms_over_bound" not in scores


@pytest.mark.parametrize(
    ("case", "cameras"),
    [("equal 0.125", 4), ("nine 0.10", 9), ("thirteen 0.30", 13), ("twentyfive 0.50", 25)],
)
def test_cases_have_their_cameras_and_densities(case: str, cameras: int) -> None:
    scene = scene_of(case)
    assert len(build_rig(scene).cameras) == cameras
    assert CASES[case].per_pixel == pytest.approx(float(case.split()[-1]))


def test_light_scatters_between_cameras_as_the_case_says() -> None:
    """By the logarithm of the ratio of two cameras' light."""
    values = scene_of("scatter 0.05").to_dict()
    values["particles"]["per_pixel"] = 0.01
    photons = [np.log(view.photons) for view in simulate(parse_scene(values, "s"), seed=7).views]
    scatter = np.mean([np.std(photons[i] - photons[j]) for i in range(4) for j in range(i)])
    assert scatter == pytest.approx(0.3, abs=0.03)
