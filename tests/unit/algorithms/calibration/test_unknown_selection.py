"""Unknowns chosen by held-out boards, and the part of residuals that is no noise."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from sabench.algorithms.calibration import unknown_selection
from sabench.algorithms.calibration.fit_checks import correlated_part, neighbours
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.algorithms.calibration.resection import place_boards
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.utils.validation import LensNumber
from tests.helpers.calibration_tanks import BOARD, make_tank, with_places
from tests.helpers.refusals import refused


def test_what_the_tank_has_is_chosen() -> None:
    case, _, _ = make_tank(k1=-0.5, bend_mm=0.3)
    chosen, rows = unknown_selection.select_unknowns(replace(case, initial_mm=place_boards(case)))
    assert {"k1", "bend"} <= set(chosen)
    assert len(chosen) <= 3
    assert rows[0].added == ()
    kept = [row.held_out_px for row in rows if row.chosen and row.held_out_px is not None]
    assert len(kept) == sum(row.chosen for row in rows)
    assert kept == sorted(kept, reverse=True)
    assert kept[-1] == pytest.approx(0.05, rel=0.2)


def test_an_ideal_tank_needs_nothing() -> None:
    case, _, _ = make_tank()
    chosen, rows = unknown_selection.select_unknowns(replace(case, initial_mm=place_boards(case)))
    assert chosen == ()
    assert len(rows) > 1


def test_frames_with_the_only_known_points_are_never_held_out() -> None:
    case, _, places = make_tank()
    case.known_mm[2, 4, 2], case.known_sigma_mm[2, 4, 2] = 70.0, 0.05
    assert sorted(np.concatenate(unknown_selection.split_frames(case)).tolist()) == [0, 1, 3, 4, 5]
    assert len(np.concatenate(unknown_selection.split_frames(with_places(case, places)))) == 6


def test_two_frames_are_too_few() -> None:
    case, _, _ = make_tank()
    case.pixels[:, 2:] = np.nan
    with refused():
        unknown_selection.select_unknowns(case)


def test_behind_other_walls_only_lenses_are_tried() -> None:
    case, _, _ = make_tank()
    wall = CylinderWall((0.0, 0.0, 90.0), (0.0, 1.0, 0.0), 90.0, 1.0, (), 1.333)
    faces = tuple(replace(camera, wall=wall) for camera in case.cameras)
    problem = CalibrationProblem.from_case(replace(case, cameras=faces), FreeParameters())
    tried = [g for g in unknown_selection._GROUPS if unknown_selection._can_free(g, problem)]
    assert {name for group in tried for name in group} == set(get_args(LensNumber))


def test_noise_is_not_shared_by_neighbours() -> None:
    pairs = neighbours(BOARD.points_mm)
    assert len(pairs) > 40  # of a grid of 6 x 5
    noise = np.random.default_rng(1).standard_normal((400, 30, 2))
    smooth = 0.5 * BOARD.points_mm[:, :2] / 25.0
    assert correlated_part(noise, pairs).max() < 0.2
    expected = np.sqrt(np.mean(smooth**2, axis=0))
    assert correlated_part(noise + smooth, pairs) == pytest.approx(expected, rel=0.15)
    assert np.isnan(correlated_part(noise[:, :1], neighbours(BOARD.points_mm[:1]))).all()
