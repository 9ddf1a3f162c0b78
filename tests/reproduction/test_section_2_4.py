"""Velocity error against baseline and plane spacing, and against trigger skew."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction import chapter_2_vortex_rings as rings, chapter_3
from sabench.scenes import build_rig


def test_setups_have_their_baseline_and_planes() -> None:
    for setup in rings._FIXED + rings._OWN + rings._SPACED:
        rig = build_rig(rings.scene_at_baseline(setup))
        centers = np.array([camera.center_mm for camera in rig.cameras])
        steps = np.diff(np.unique(centers[:, 0].round(6)))
        assert steps / 510.0 == pytest.approx(setup.baseline)
        assert rig.grid.voxel_mm[2] == pytest.approx(setup.plane_mm)
        assert round(2.0 / setup.plane_mm) in (4, 8, 12, 16, 20, 24, 32)
    assert rings.plane_mm(0.4) == pytest.approx(0.125, rel=1e-3)


def test_a_larger_baseline_measures_depth_better(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rings, "_VOLUMES", ("msa",))
    few, many = (
        rings._measure(rings.Setup(baseline, 0.125), [1], 220)["msa"][0] for baseline in (0.1, 0.4)
    )
    assert many[2] < 0.8 * few[2]


def test_skew_costs_nothing_in_short_pulses_and_much_in_fast_continuous_light() -> None:
    lights = chapter_3.lights()
    fast, pulsed = lights[3], lights[4]
    together, skewed = (chapter_3._measure(fast, skew, 1, 100) for skew in (0.0, 125e-6))
    assert together.images < 1e-3
    # 1 m/s and a uniform skew: 0.125 / sqrt(3) mm in cells of 0.2 mm where the fluid is fastest
    assert 0.1 < skewed.images < 0.125 / np.sqrt(3.0) / 0.2
    assert skewed.q < together.q
    same = chapter_3._measure(pulsed, 125e-6, 1, 100)
    assert same.images == pytest.approx(0.0, abs=1e-9)
    assert same.lost == 0.0


def test_a_shorter_step_between_pulses_loses_images() -> None:
    light = chapter_3.lights()[-1]
    scene = chapter_3.scene_of(light, 125e-6, 1)
    assert scene.timing is not None
    assert scene.timing.skew_s is not None
    margin = (light.step_s - chapter_3.GAP_S) / 2.0
    late = np.mean(np.abs(scene.timing.skew_s) > margin)
    cost = chapter_3._measure(light, 125e-6, 1, 100)
    assert cost.lost == pytest.approx(late / 2.0)  # one of the two pulses
