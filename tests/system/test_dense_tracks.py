"""Tracks begin where single frames show too many ghosts."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sabench.algorithms.particles import (
    BayesianIprSettings,
    ShakeTheBoxSettings,
    fit_cameras,
    shake_the_box,
    track_particles,
)
from sabench.algorithms.particles.bayesian_ipr import Known, search_frame
from sabench.api import FoundParticles
from sabench.scenes import find, parse_scene
from sabench.simulation.in_memory import Shot, simulate_sequence

NEAR_MM = 0.025  # half a pixel
TIMES = [0.01 * number for number in range(8)]


def shots_of(per_pixel: float, frames: int) -> list[Shot]:
    """Frames of 80 x 80 pixels, four cameras, turbulence of 3 pixels a frame."""
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    values["frames"] = frames
    values["volume"]["size_mm"] = [4.6, 4.6, 3.0]
    values["cameras"] |= {"rows": 80, "columns": 80}
    values["particles"]["per_pixel"] = per_pixel
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    return list(simulate_sequence(parse_scene(values, "dense"), seed=7))


@pytest.mark.slow
def test_known_particles_help_to_find_the_others() -> None:
    (shot,) = shots_of(0.26, 1)
    truth, maps = shot.particles.position_mm, fit_cameras(shot.observation)
    given = np.random.default_rng(8).random(len(truth)) < 0.5
    light = np.zeros((int(given.sum()), 4))  # not known
    known = Known(truth[given], light)
    alone = search_frame(shot.observation, maps, BayesianIprSettings())
    together = search_frame(shot.observation, maps, BayesianIprSettings(), known)
    assert alone is not None
    assert together is not None
    others = truth[~given]
    before, after = (
        (cKDTree(search.found().position_mm).query(others)[0] < NEAR_MM).mean()
        for search in (alone, together)
    )
    assert after > before + 0.1
    assert after > 0.85


def track(shots: list[Shot]) -> list[FoundParticles]:
    cases = [shot.observation for shot in shots]
    settings = ShakeTheBoxSettings(BayesianIprSettings())
    return list(track_particles(cases, TIMES[: len(cases)], fit_cameras(cases[0]), settings))


@pytest.mark.slow
@pytest.mark.parametrize("frames", [3, 8])
def test_held_frames_come_in_order_and_as_good(
    frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of any number of frames, each comes once, and easy images give the same particles."""
    shots = shots_of(0.03, frames)
    usual = track(shots)
    monkeypatch.setattr(shake_the_box, "are_mostly_wrong", lambda *_: True)
    held = track(shots)
    assert len(held) == frames
    for shot, one, other in zip(shots, usual, held, strict=True):
        assert abs(len(one.position_mm) - len(other.position_mm)) <= 3
        distance, _ = cKDTree(shot.particles.position_mm).query(other.position_mm)
        assert (distance < NEAR_MM).mean() > 0.97
        assert other.velocity_mm_s is not None
