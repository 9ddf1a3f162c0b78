"""Frames made in memory."""

from typing import Any

import numpy as np

import sabench
from sabench.dataset.reader import Dataset
from tests.helpers.refusals import refused


def test_a_scene_may_be_a_name_and_gives_the_particles_of_its_data_set(quick: Dataset) -> None:
    shot = sabench.simulate("quick", seed=quick.manifest.seed, backend="splat")
    truth = quick.particles(0).position_mm
    assert np.array_equal(shot.particles.position_mm, truth)


def test_a_scene_without_particles_is_refused() -> None:
    with refused("expected a scene with particles"):
        sabench.simulate("standard-bubbles")
    for key, value in {"seed": 1.5, "frame": 1, "scene": None}.items():
        given: Any = {"scene": "quick", key: value}
        with refused(key):
            sabench.simulate(**given)


def test_a_data_set_shows_itself_in_five_lines(quick: Dataset) -> None:
    lines = repr(quick).splitlines()
    assert len(lines) == 5
    assert "cameras: 4 of 320 x 240 px" in repr(quick)
    assert "particles, with truth" in repr(quick)
    assert "apart" not in repr(quick)  # it has one frame
