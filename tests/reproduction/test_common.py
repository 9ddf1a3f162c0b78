"""Verdicts and crossings are what they say, and a coarse copy is the same array."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction import MEASUREMENTS, reproduce
from reproduction.chapter_2_cameras import by_cameras, falls_to
from reproduction.chapter_2_density import crossings, plane_spacing_mm
from reproduction.common import (
    at_least,
    cases,
    claim,
    coarsen,
    density,
    make_row,
    per_pixel,
    verdict,
    with_density,
)
from reproduction.refocused_frames import METHODS, measure_quality
from sabench.evaluation.suites import SceneCase
from sabench.scenes import build_rig, load_scene
from sabench.simulation.in_memory import make_particles
from sabench.utils.errors import InputError


@pytest.mark.parametrize(
    ("measured", "thesis", "expected"),
    [
        (1.04, 1.0, "reproduced"),
        (0.96, 1.0, "reproduced"),
        (1.06, 1.0, "exceeds"),
        (0.94, 1.0, "below"),
        (-1.04, -1.0, "reproduced"),
        (3.0, None, "not in the thesis"),
    ],
)
def test_verdicts(measured: float, thesis: float | None, expected: str) -> None:
    assert verdict(measured, thesis, "larger") == expected


def test_rows_hold_the_mean_over_seeds() -> None:
    row = make_row("x", 2.0, [1.0, 2.0, 3.0], "note")
    assert (row.measured, row.verdict, row.seeds, row.note) == (2.0, "reproduced", 3, "note")
    assert row.ci95 == pytest.approx(2.484, abs=1e-3)
    missing = make_row("x", 2.0, [])
    assert (missing.measured, missing.ci95, missing.verdict) == (None, None, "not reached")


def test_bounds_and_claims() -> None:
    assert at_least("x", 0.75, [0.8, 0.9]).verdict == "reproduced"
    assert at_least("x", 0.75, [0.74]).verdict == "below"
    assert at_least("x", 0.75, []).verdict == "below"
    assert claim("x", "it falls", 0.5, True).verdict == "reproduced"
    assert claim("x", "it falls", 0.5, False).verdict == "not reproduced"


@pytest.mark.parametrize("start", [0.5, 3.0, 20.0])
def test_the_crossing_is_found_from_either_side(start: float) -> None:
    """Crossings of a Q that falls as a straight line through 0.75.

    It is 0.75 at 3.0 for seed 1, and at a little more for seed 2.
    """
    found = crossings(
        lambda per_mm3, seed: 0.75 - 0.05 * (per_mm3 - 3.0 - 0.1 * (seed - 1)), start, [1, 2]
    )
    assert found == pytest.approx([3.0, 3.1])


def test_no_crossing_is_no_density() -> None:
    assert crossings(lambda per_mm3, seed: 0.9, 1.0, [1]) == []


def test_the_first_fall_below_a_level() -> None:
    assert falls_to(0.75, [0.0, 1.0, 2.0], [0.9, 0.8, 0.7]) == pytest.approx(1.5)
    assert falls_to(0.75, [0.0, 1.0], [0.9, 0.8]) is None
    assert falls_to(0.75, [0.0, 1.0], [0.7, 0.6]) is None


@pytest.mark.parametrize("case", cases("table-2-1"), ids=lambda case: str(case.name))
def test_plane_spacing_is_that_of_equation_2_10(case: SceneCase) -> None:
    rig = build_rig(case.scene)
    across, _, along = rig.grid.voxel_mm
    distance = -rig.cameras[12].center_mm[2]
    baseline = (rig.cameras[13].center_mm[0] - rig.cameras[12].center_mm[0]) / distance
    expected = across / baseline / (1.0 - across / (baseline * distance))
    assert plane_spacing_mm(rig.cameras[12], rig.cameras[13], across) == pytest.approx(
        expected, rel=1e-9
    )
    assert along == pytest.approx(expected, rel=0.01)


def test_a_coarse_copy_has_the_same_cameras_and_as_many_particles_per_pixel() -> None:
    scene = with_density(load_scene("thesis-50x50x10"), 6.0)
    coarse = coarsen(scene, 100)
    assert coarsen(scene, None) == scene
    assert per_pixel(coarse) == pytest.approx(per_pixel(scene)) == 0.15
    assert density(coarse) == pytest.approx(0.06)
    assert len(make_particles(coarse, 1, 0)) == 1500
    fine_rig, coarse_rig = build_rig(scene), build_rig(coarse)
    assert coarse_rig.grid.shape == (8, 100, 100)
    for fine, small in zip(fine_rig.cameras, coarse_rig.cameras, strict=True):
        assert (small.center_mm, small.rotation) == (fine.center_mm, fine.rotation)
        assert small.principal_distance_mm == pytest.approx(fine.principal_distance_mm, rel=1e-12)


def test_numbers_of_cameras_are_those_of_the_cases() -> None:
    found = by_cameras("fig-2-7a")
    assert [cameras for cameras, _ in found] == [5, 9, 13, 17, 21, 25] * 3
    np.testing.assert_allclose(
        [density(case.scene) for _, case in found], np.repeat([2.0, 3.0, 5.0], 6)
    )


def test_quality_falls_with_density_and_depends_on_the_threshold() -> None:
    scene = load_scene("array-9")
    few, many = (
        measure_quality(coarsen(with_density(scene, per_mm3), 100), 1) for per_mm3 in (1.0, 8.0)
    )
    for method in METHODS:
        assert few[method].best > many[method].best > 0.5
        assert few[method].best >= few[method].blind > 0.9 * few[method].best


def test_an_unknown_table_names_the_known_ones() -> None:
    with pytest.raises(
        InputError,
        match=r"table-2-4: expected one of all, table-2-1, .*fig-4-27.*; did you mean table-2-\d\?",
    ):
        reproduce(["table-2-4"])
    assert all(one.title for one in MEASUREMENTS.values())
