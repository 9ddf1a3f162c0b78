"""What every reconstruction solver must do, bundled or not: one suite over all that `sabench list` shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sabench import plugins
from sabench.api import Observation, Reconstruction
from sabench.api.make import make_solver
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import load_scene, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.tasks.columns import COLUMNS

SOLVERS = [
    name
    for name in plugins.names("solvers")
    if plugins.load("solvers", name).track == "reconstruction"
]


@pytest.fixture(scope="module")
def shot() -> Shot:
    """Four cameras in water behind glass, unequal sides everywhere, particles far apart."""
    values = load_scene("quick").to_dict()
    values["volume"]["size_mm"] = [9.0, 6.0, 3.0]
    values["particles"]["count"] = 60
    return simulate(parse_scene(values, "small"), seed=5)


@pytest.mark.parametrize("name", plugins.names("solvers"))
def test_a_solver_says_what_it_is(name: str) -> None:
    plugin = plugins.load("solvers", name)
    assert plugin.track in COLUMNS
    assert plugin.sees != "target" or plugin.track == "calibration"
    assert plugin.references
    assert plugins.summary(plugin).endswith(".")
    for key, field in plugin.Parameters.model_fields.items():
        assert field.description, f"{name}: parameter {key} has no description"
        assert not field.is_required(), f"{name}: parameter {key} has no default"


@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_finds_particles_the_same_way_twice(name: str, shot: Shot) -> None:
    first, second = (make_solver(name, {}).solve(shot.observation) for _ in range(2))
    assert first.volume.dtype == np.float32
    assert first.volume.shape == shot.observation.grid.shape
    assert np.isfinite(first.volume).all()
    assert first.volume.min() >= 0.0
    np.testing.assert_array_equal(first.volume, second.volume)
    scores = score_frame(shot.observation.grid, shot.particles, shot.views, first)
    # whole-pixel shifts are made for cameras on one plane in air: behind glass they find less
    least = 20.0 if name == "map_shift_average" else 80.0
    assert scores["true_percent"] is not None
    assert scores["true_percent"] > least


@pytest.mark.parametrize("name", SOLVERS)
def test_no_light_is_no_particles(name: str, shot: Shot) -> None:
    dark = replace(
        shot.observation,
        images=np.full_like(shot.observation.images, int(shot.observation.black_dn)),
    )
    assert not solved(name, dark).volume.any()


@pytest.mark.parametrize("name", SOLVERS)
def test_one_covered_camera_stops_nobody(name: str, shot: Shot) -> None:
    images = shot.observation.images.copy()
    images[1] = int(shot.observation.black_dn)
    assert np.isfinite(solved(name, replace(shot.observation, images=images)).volume).all()


@pytest.mark.parametrize("name", SOLVERS)
def test_cameras_may_come_in_any_order(name: str, shot: Shot) -> None:
    """Sums and products do not care; solvers that go camera by camera change their figures, not their particles."""
    seen = shot.observation
    turned = replace(seen, images=seen.images[::-1].copy(), cameras=seen.cameras[::-1])
    one, other = solved(name, seen).volume, solved(name, turned).volume
    correlation = float((one * other).sum() / np.sqrt((one**2).sum() * (other**2).sum()))
    assert correlation > 0.95


def solved(name: str, case: Observation) -> Reconstruction:
    return make_solver(name, {}).solve(case)
