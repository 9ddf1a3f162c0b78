"""Something hides half of the volume from one of the cameras."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.api import FoundParticles, ImageSequence
from sabench.api.make import make_algorithm
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.metrics.particle_detection import count_challenge
from sabench.scenes import Scene, parse_scene
from sabench.scenes.loading import find
from sabench.simulation.in_memory import Shot, simulate, simulate_sequence

TOP_LEFT = {3: (-151.5, -158.0), 2: (-72.5, -79.0)}  # of discs, by the cameras in a row


def make_scene(in_a_row: int) -> Scene:
    values = read("standard-particles")
    values["cameras"]["layout"] |= {"columns": in_a_row, "rows": in_a_row}
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    values["occluders"] = [{"center_mm": [*TOP_LEFT[in_a_row], -400.0], "radius_mm": 6.0}]
    return parse_scene(values, f"{in_a_row} x {in_a_row} cameras")


def read(name: str) -> dict[str, Any]:
    return tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))


def search(shot: Shot) -> ParticleSearch:
    case = shot.observation
    found = search_frame(case, fit_cameras(case), BayesianIprSettings())
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("in_a_row", "seed"), [(3, 2), (2, 1)])
def test_particles_are_found_where_a_camera_is_blind(in_a_row: int, seed: int) -> None:
    """Of nine cameras, one hardly shows in the light that is left; of four, ghosts hide it."""
    shot = simulate(make_scene(in_a_row), seed=seed)
    found = search(shot)
    assert found.hidden is not None
    assert 0.35 < found.hidden[0].mean() < 0.6
    assert not found.hidden[1:].any()
    grid, true = shot.observation.grid, shot.particles.position_mm
    here = grid.to_voxels(points_in_mm(found.maps, found.position))
    there = grid.to_voxels(true)
    inside = np.abs((true - found.maps.middle_mm) / found.maps.half_mm).max(axis=1) < 1.0
    all_found = count_challenge(here, there, np.ones(len(here), dtype=np.bool_), inside)
    assert all_found.recall > 0.985  # also at the edges of the volume
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    assert counts.recall > 0.995
    assert counts.detections - counts.matched < 0.005 * counts.truths


def test_dark_areas_of_few_particles_hide_nothing() -> None:
    values = read("realistic-particles")
    values["particles"]["per_pixel"] = 0.005
    assert search(simulate(parse_scene(values, "few"), seed=1)).hidden is None


@pytest.mark.slow
def test_trajectories_go_on_when_something_moves_in_front_of_a_camera() -> None:
    """From the fourth of six frames on, one of four cameras sees half of the volume."""
    values = read("particle-tracking") | {"frames": 6}
    values["illumination"] |= {"scattering": "isotropic"}
    before = list(simulate_sequence(parse_scene(values, "free"), seed=2))
    disc = {"center_mm": [-156.6, -164.6, -400.0], "radius_mm": 8.0}
    after = list(simulate_sequence(parse_scene(values | {"occluders": [disc]}, "hidden"), seed=2))
    shots = [*before[:3], *after[3:]]
    case = ImageSequence.of([one.observation for one in shots], 0.01)
    solver: Any = make_algorithm("shake_the_box", {})
    found: list[FoundParticles] = list(solver.solve(case))
    for shot, one in zip(shots, found, strict=True):
        grid = shot.observation.grid
        here, there = (grid.to_voxels(p) for p in (one.position_mm, shot.particles.position_mm))
        counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
        assert counts.recall > 0.995
        assert counts.detections - counts.matched < 0.005 * counts.truths
