"""Tracers around a body: none passes through it, and bad scenes are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.errors import InputError
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.library.overlaps import contains
from sabench.worlds.tracers import Motion, require_flow


def coarse(**changes: Any) -> Scene:
    """The reef on a coarse lattice, in few steps."""
    values = load_scene("flow-behind-reef").to_dict()
    values["flow"] |= {"step_mm": 0.8}
    values["solids"][0] |= {"branches": 12, "step_mm": 0.5}
    values["particles"] = {"generator": "uniform", "count": 1500}
    values |= {"frames": 3, "interval_s": 0.2} | changes
    return parse_scene({k: v for k, v in values.items() if v is not None}, "coarse")


def test_no_tracer_that_starts_outside_ends_in_the_body() -> None:
    """Over 4 mm of mean flow, a tenth of the mean distance through the reef would show."""
    scene = coarse()
    body = Phases(scene, 1).bodies(0)[0][0]
    motion = Motion(scene, 1)
    first, last = motion.at(0), motion.at(2)
    _, i, j = np.intersect1d(first.id, last.id, return_indices=True)
    outside = ~contains(body, first.position_mm[i])
    moved = np.linalg.norm(last.position_mm[j] - first.position_mm[i], axis=1)
    assert np.median(moved[outside]) > 2.0
    assert contains(body, last.position_mm[j][outside]).sum() <= 0.01 * outside.sum()
    assert np.median(moved[~outside]) < 0.5


def test_flow_is_of_the_bodies_of_the_seed() -> None:
    scene = coarse()
    point = np.array([[-2.0, 3.0, 0.0]])
    one, same, other = (require_flow(scene, seed).velocity(point, 0.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1e-3


def test_bodies_that_move_and_missing_bodies_are_refused() -> None:
    solid = coarse().to_dict()["solids"][0]
    moving = coarse(solids=[solid | {"velocity_mm_s": [1.0, 0.0, 0.0]}])
    with pytest.raises(InputError, match=r"expected bodies at rest, but solids\.0 moves"):
        require_flow(moving, 1)
    with pytest.raises(InputError, match="expected solids that it goes around, got none"):
        require_flow(coarse(solids=None, lighting=None, render=None), 1)
