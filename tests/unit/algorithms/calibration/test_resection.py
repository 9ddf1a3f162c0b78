"""Poses of boards and cameras from known points."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.calibration.resection import known_places, place_boards, upright_axes
from sabench.api.truth import Target
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.utils.arrays import F64
from tests.helpers.calibration_tanks import BOARD, MIDDLE, make_tank, rotated, solve, with_places

Y_UP = np.diag([1.0, -1.0, -1.0])  # Y up, Z towards the cameras
ALONG_X = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
ANY = rotation_matrices(np.array([0.7, -1.1, 0.4]))


@pytest.mark.parametrize("rotation", [Y_UP, ALONG_X, ANY])
def test_boards_are_calibrated_in_any_world(rotation: F64) -> None:
    case, _, places = make_tank()
    case = rotated(case, rotation)
    plain = BOARD.points_mm @ upright_axes(case.cameras).T + rotation @ MIDDLE
    found: Any = solve(replace(case, initial_mm=np.tile(plain, (6, 1, 1)))).points_mm
    some = (one.reshape(-1, 3)[::7] for one in (found, places))
    own, true = (np.linalg.norm(one[:, None] - one, axis=-1) for one in some)
    assert np.abs(own - true).mean() < 0.02  # no motion changes distances


def test_a_board_upside_down_is_found() -> None:
    case, _, _ = make_tank()
    found = place_boards(replace(case, pixels=case.pixels[:, :, ::-1]))
    right = place_boards(case)
    assert_allclose(found[:, ::-1].mean(axis=1), right.mean(axis=1), atol=0.5)
    assert_allclose(found[:, 0], right[:, -1], atol=2.0)


def test_known_points_place_a_board() -> None:
    case, _, places = make_tank()
    assert np.isnan(known_places(case)).all()
    some = with_places(case, places, 1e-6)
    some.known_mm[:, 3:-1] = np.nan
    assert_allclose(known_places(some), places, atol=1e-3)


def test_a_target_of_one_point_is_where_that_is_known() -> None:
    case, _, places = make_tank()
    ball = replace(
        case,
        target=Target.from_places(((3.0, 0.0, 0.0),)),
        pixels=case.pixels[:, :, :1],
        initial_mm=case.initial_mm[:, :1],
        known_mm=places[:, :1],
        known_sigma_mm=np.full_like(places[:, :1], 1e-6),
    )
    assert_allclose(known_places(ball), places[:, :1], atol=1e-12)
