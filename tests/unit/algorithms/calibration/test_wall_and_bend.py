"""The wall's place and a board's bend as unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sabench.algorithms.calibration.bundle_adjustment import normal_equations
from sabench.algorithms.calibration.joint_fit import fit_jointly, make_prior
from sabench.algorithms.calibration.parameters import FreeParameters
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.algorithms.calibration.resection import place_boards
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.utils.arrays import triple
from tests.helpers.calibration_tanks import WALL, make_tank, solve, with_places


def test_gradients_are_those_of_the_cost() -> None:
    case, _, places = make_tank(bend_mm=0.5)
    case = with_places(case, places)
    free = FreeParameters(
        principal_point=True,
        distortion=("k1",),
        indices=(2,),
        thicknesses=(0,),
        wall=True,
        bend=True,
    )
    problem = CalibrationProblem.from_case(replace(case, initial_mm=places + 0.3), free)
    anchors = make_anchors(problem.case, problem.frame, 0.1)
    seen = replace(problem.seen, anchors=anchors, prior=make_prior(problem.start, 0.1))
    shared = np.array([0.0, 1e-3, 1e-3, -2e-3, 1e-3, 0.1, 0.2, -0.1])  # a state away from none
    state = problem.start.apply_steps(np.zeros((3, 10)), shared, np.zeros((6, 6)), free)
    normal = normal_equations(state, seen, free)
    steps = [1e-6] * 3 + [1e-4] * 3 + [1e-3] * 3 + [1e-6]
    steps = [*steps * 3, 1e-6, 1e-5, 1e-7, 1e-7, 1e-4, 1e-5, 1e-5, 1e-5]
    for number, step in enumerate(steps):
        costs = []
        for sign in (1.0, -1.0):
            vector = np.zeros(len(steps))
            vector[number] = sign * step
            there = state.apply_steps(
                vector[:30].reshape(3, 10), vector[30:], np.zeros((6, 6)), free
            )
            costs.append(normal_equations(there, seen, free).cost)
        slope = -(costs[0] - costs[1]) / (4.0 * step)
        assert normal.a[number] == pytest.approx(slope, rel=1e-4, abs=1e-3 * abs(normal.a).max())


def test_a_wall_that_is_elsewhere_is_found_by_known_places() -> None:
    case, _, places = make_tank()
    tilted = triple(np.array([np.sin(0.02), 0.0, np.cos(0.02)]))
    wall = replace(WALL, point_mm=(0.0, 0.0, -40.0), normal=tilted)
    off = replace(case, cameras=tuple(replace(camera, wall=wall) for camera in case.cameras))
    off = replace(with_places(off, places), unknown=("wall",))
    answer = solve(off)
    camera = answer.cameras[0]
    assert isinstance(camera, Camera)
    found = camera.wall
    assert isinstance(found, Wall)
    assert abs(found.depth_of(np.array([0.0, 0.0, 0.0]))) < 1.0
    assert found.normal[2] > np.cos(np.deg2rad(0.2))
    assert answer.points_mm is not None
    np.testing.assert_allclose(answer.points_mm, places, atol=0.03)


def test_a_bent_board_is_found() -> None:
    case, _, places = make_tank(bend_mm=0.3)
    case = replace(case, initial_mm=place_boards(case))
    problem = CalibrationProblem.from_case(case, FreeParameters(bend=True))
    flat = fit_jointly(problem, FreeParameters())
    bent = fit_jointly(problem, FreeParameters(bend=True))
    assert flat.noise_px > 0.08
    assert bent.noise_px == pytest.approx(0.05, rel=0.1)
    np.testing.assert_allclose(bent.fit.state.bend, [-0.3, 0.0, -0.3], atol=0.02)
    own = bent.fit.state.points(problem.seen.board)[0]
    apart = [np.linalg.norm(one[0] - one[-1]) for one in (own, places[0])]
    assert apart[0] == pytest.approx(apart[1], abs=1e-3)
