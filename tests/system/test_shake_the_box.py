"""Particles followed through small sequences, and through frames that show none."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sabench.algorithms.particles import (
    BayesianIprSettings,
    ShakeTheBoxSettings,
    fit_cameras,
    track_particles,
)
from sabench.api import FoundParticles, Observation
from sabench.metrics.particle_detection import Counts, count_challenge
from sabench.scenes import find, parse_scene
from sabench.simulation.in_memory import Shot, simulate, simulate_sequence

FRAMES, STEP_S = 6, 0.01
SETTINGS = ShakeTheBoxSettings(BayesianIprSettings())


@functools.cache
def make_shots(per_pixel: float = 0.06) -> tuple[Shot, ...]:
    """Frames of a smaller scene of tracking, with displacements of some 3 px."""
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    values["frames"] = FRAMES
    values["volume"]["size_mm"] = [7.0, 7.0, 5.0]
    values["grid"]["crop_mm"] = [0.8, 0.8, 0.3]
    values["cameras"] |= {"rows": 130, "columns": 130}
    values["particles"]["per_pixel"] = per_pixel
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    scene = parse_scene(values, "test")
    return tuple(simulate_sequence(scene, seed=21))


def follow(cases: Sequence[Observation]) -> list[FoundParticles]:
    times = [STEP_S * number for number in range(len(cases))]
    return list(track_particles(iter(cases), times, fit_cameras(cases[0]), SETTINGS))


def count(shot: Shot, found: FoundParticles) -> Counts:
    grid = shot.observation.grid
    here, there = grid.to_voxels(found.position_mm), grid.to_voxels(shot.particles.position_mm)
    return count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))


def joined(shots: Sequence[Shot], found: Sequence[FoundParticles]) -> float:
    """The share of the particles found in the first and last frame that a trajectory joins."""
    names = []
    for shot, one in ((shots[0], found[0]), (shots[-1], found[-1])):
        apart = np.linalg.norm(one.position_mm[:, None] - shot.particles.position_mm, axis=2)
        near = apart.argmin(axis=0)
        good = apart.min(axis=0) < 0.03
        assert one.trajectory is not None
        names.append(dict(zip(shot.particles.id[good], one.trajectory[near[good]], strict=True)))
    both = names[0].keys() & names[1].keys()
    assert len(both) > 300
    return float(np.mean([names[0][name] == names[1][name] for name in both]))


@pytest.mark.slow
def test_particles_are_followed_and_ghosts_end() -> None:
    shots = make_shots()
    found = follow([shot.observation for shot in shots])
    for shot, one in zip(shots, found, strict=True):
        counts = count(shot, one)
        assert counts.truths > 300
        assert counts.recall > 0.99
        assert counts.precision > 0.99
    assert joined(shots, found) > 0.99


@pytest.mark.slow
def test_trajectories_bridge_a_frame_that_is_dark() -> None:
    shots = make_shots()
    cases = [shot.observation for shot in shots]
    dark = np.full_like(cases[3].images, 64)
    cases[3] = replace(cases[3], images=dark)
    found = follow(cases)
    counts = count(shots[3], found[3])  # positions between the frames before and after it
    assert counts.recall > 0.95
    assert counts.precision > 0.98
    assert joined(shots, found) > 0.97


@pytest.mark.slow
def test_a_sequence_may_begin_in_the_dark_or_be_dark() -> None:
    shots = make_shots()
    cases = [shot.observation for shot in shots[:3]]
    dark = replace(cases[0], images=np.full_like(cases[0].images, 64))
    found = follow([dark, *cases[1:]])
    assert len(found[0].position_mm) == 0
    assert count(shots[2], found[2]).recall > 0.99
    assert [len(one.position_mm) for one in follow([dark] * 3)] == [0] * 3


@pytest.mark.slow
def test_tracking_begins_again_after_many_dark_frames() -> None:
    shots = make_shots()
    cases = [shot.observation for shot in shots]
    for number in (2, 3, 4):
        cases[number] = replace(cases[number], images=np.full_like(cases[number].images, 64))
    found = follow(cases)
    assert len(found[4].position_mm) == 0
    assert count(shots[1], found[1]).recall > 0.98
    assert count(shots[5], found[5]).recall > 0.98


def test_a_single_frame_is_searched() -> None:
    shots = make_shots()
    found = follow([shots[0].observation])
    assert count(shots[0], found[0]).recall > 0.98


@pytest.mark.slow
def test_frames_one_after_the_other_are_the_same_as_single_ones() -> None:
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    values["frames"], values["particles"]["per_pixel"] = 3, 0.002
    scene = parse_scene(values, "test")
    for frame, shot in enumerate(simulate_sequence(scene, seed=3)):
        single = simulate(scene, seed=3, frame=frame).observation
        np.testing.assert_array_equal(shot.observation.images, single.images)


@pytest.mark.slow
def test_a_camera_whose_image_is_another_frames_is_left_out_there() -> None:
    """The search of the frame has fewer cameras than the one that it is linked to."""
    shots = make_shots(0.02)
    cases = [shot.observation for shot in shots]
    images = cases[1].images.copy()
    images[-1] = cases[5].images[-1]
    cases[1] = replace(cases[1], images=images)
    with pytest.warns(UserWarning, match="the camera is left out"):
        found = follow(cases[:3])
    counts = count(shots[1], found[1])
    assert counts.recall > 0.9
