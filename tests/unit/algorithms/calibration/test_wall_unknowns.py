"""Wall, bend and tilt as unknowns."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.calibration.bundle_adjustment import BoardImages, normal_equations
from sabench.algorithms.calibration.cramer_rao import _inverse, _whole, compute_bound
from sabench.algorithms.calibration.joint_fit import fit_jointly, make_prior
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.algorithms.calibration.resection import place_boards
from sabench.api import CalibrationCase
from sabench.apps.own_calibration.report import wall_unknowns, warn_of_unknowns
from sabench.geometry.camera import Camera, aim
from sabench.utils.arrays import F64, triple
from sabench.utils.validation import Unknown
from tests.helpers.calibration_tanks import MIDDLE, WALL, make_tank, solve, with_places
from tests.helpers.refusals import check_sentence, refused

N, M = 1.5, 1.333  # glass and fluid of WALL
LEANING = triple(np.array([np.sin(0.02), 0.0, np.cos(0.02)]))
ALL: tuple[Unknown, ...] = ("wall", "thickness", "layer_index", "fluid_index")


def known_case(unknown: tuple[Unknown, ...] = ALL) -> tuple[CalibrationCase, F64]:
    case, cameras, places = make_tank()
    case = replace(with_places(case, places), cameras=cameras, initial_mm=places + 0.3)
    return replace(case, known_cameras=True, unknown=unknown), places


def slopes_of(
    problem: CalibrationProblem, free: FreeParameters, shared: F64, steps: list[float]
) -> tuple[F64, F64, State]:
    """Gradient of the cost by the equations and by differences, at a state away from none."""
    anchors = make_anchors(problem.case, problem.frame, 0.1)
    seen = replace(problem.seen, anchors=anchors, prior=make_prior(problem.start, 0.1))
    own, boards = len(steps) - len(shared), np.zeros((6, 6))
    still = np.zeros((3, max(own // 3, 7)))
    state = problem.start.apply_steps(still, shared, boards, free)
    numeric = []
    for vector in np.diag(steps):
        costs = []
        for end in (vector, -vector):
            cameras = end[:own].reshape(3, -1) if own else still
            there = state.apply_steps(cameras, end[own:], boards, free)
            costs.append(normal_equations(there, seen, free).cost)
        numeric.append(-(costs[0] - costs[1]) / (4.0 * vector.sum()))
    return normal_equations(state, seen, free).a, np.array(numeric), state


def test_gradients_with_known_cameras_are_those_of_the_cost() -> None:
    case, _ = known_case()
    free = FreeParameters.from_case(case)
    problem = CalibrationProblem.from_case(case, free)
    shared = np.array([1e-3, 2e-3, 0.1, 2e-2, -1e-2, 3.0])
    steps = [1e-6, 1e-6, 1e-5, 1e-7, 1e-7, 1e-4]
    gradient, numeric, state = slopes_of(problem, free, shared, steps)
    assert_allclose(gradient, numeric, rtol=1e-5)
    for camera, own in zip(problem.frame.build_cameras(state), case.cameras, strict=True):
        assert_allclose(camera.center_mm, own.center_mm, atol=1e-9)
        assert_allclose(camera.rotation, own.rotation, atol=1e-12)


def bound_of(case: CalibrationCase, cameras: tuple[Camera, ...], places: F64) -> tuple[F64, F64]:
    """Return the covariance of the shared unknowns, and their bound, at the truth."""
    frame, free = WallFrame.from_cameras(cameras, places), FreeParameters.from_case(case)
    state, board = frame.state(case.target.points_mm, places), case.target.points_mm
    anchors = make_anchors(case, frame, 0.05)
    seen = BoardImages(board, np.nan_to_num(case.pixels), np.ones(case.pixels.shape[:3]), anchors)
    covariance, _, _ = _inverse(_whole(state, seen, free))
    count = len(free.columns(len(state.indices))[1])
    return covariance[:count, :count], compute_bound(state, seen, free, 0.05).shared_std


@pytest.mark.parametrize("unknown", [("wall",), ("wall", "thickness")])
def test_a_wall_in_front_of_known_cameras_is_found(unknown: tuple[Unknown, ...]) -> None:
    case, places = known_case(unknown)
    layers = (replace(WALL.layers[0], thickness_mm=8.7),) if "thickness" in unknown else WALL.layers
    off = replace(WALL, point_mm=(0.0, 0.0, -10.0), normal=LEANING, layers=layers)
    nominal = tuple(replace(camera, wall=off) for camera in case.cameras)
    found: Any = solve(replace(case, cameras=nominal)).cameras[0]
    assert_allclose(found.center_mm, case.cameras[0].center_mm, atol=1e-9)
    _, std = bound_of(case, case.cameras, places)
    free = FreeParameters.from_case(case)
    unknowns: Any = wall_unknowns(WALL, found.wall, free, std)
    for one in unknowns:
        assert abs(one.found - one.nominal) < 3.5 * one.std, one


@pytest.mark.parametrize(
    ("places_known", "expected"),
    [
        (True, (1.0 / M - 1.0 / N) / (1.0 - 1.0 / M)),
        (False, (1.0 / M**2 - 1.0 / N**2) / N / (1.0 - 1.0 / M**2)),
    ],
)
def test_thickness_and_place_are_one_at_small_angles(places_known: bool, expected: float) -> None:
    """To leading order in the angle, images show one combination of place and thickness. A ray with
    the invariant p = sin a meets the depth of its point at the distance d p / sqrt(1 - p^2) + t p /
    sqrt(n^2 - p^2) + e p / sqrt(m^2 - p^2) from the normal through the pinhole: d to the wall, t of
    glass of index n, e of fluid of index m. That is p (d + t / n + e / m) to first order, and p^3 /
    2 (d + t / n^3 + e / m^3) more to third. With known places d + t + e is fixed, and place and
    thickness differ by p^3 only; without, the boards' depth takes up the first order."""
    stds, ratios = [], []
    for narrow in (0.5, 0.25):
        case, cameras, places = make_tank()
        scale = np.array([narrow, narrow, 1.0])
        cameras = tuple(
            aim(replace(camera, center_mm=triple(camera.center_mm * scale)), MIDDLE)
            for camera in cameras
        )
        case = with_places(case, places) if places_known else case
        case = replace(case, cameras=cameras, known_cameras=True, unknown=("wall", "thickness"))
        covariance, std = bound_of(case, cameras, places)
        ratios.append(covariance[0, 3] / covariance[0, 0])  # of place by thickness
        stds.append(std[0])
    assert ratios[1] == pytest.approx(expected, rel=0.03)
    assert abs(ratios[1] - expected) < abs(ratios[0] - expected)
    assert stds[1] > 2.0 * stds[0]


def test_index_and_thickness_are_one() -> None:
    """An error of the index looks like one of the thickness, by n^2 (1/n - 1/m) / t."""
    case, cameras, places = make_tank()
    known = replace(with_places(case, places), known_cameras=True, cameras=cameras)
    covariance, _ = bound_of(replace(known, unknown=("thickness", "layer_index")), cameras, places)
    expected = N**2 * (1.0 / N - 1.0 / M) / 8.0
    assert covariance[0, 1] / covariance[1, 1] == pytest.approx(expected, rel=0.1)


def test_what_the_data_hardly_show_is_a_sentence() -> None:
    case, cameras, places = make_tank()
    case = replace(case, cameras=cameras, known_cameras=True, unknown=("wall", "thickness"))
    _, std = bound_of(case, cameras, places)
    unknowns = wall_unknowns(WALL, WALL, FreeParameters.from_case(case), std)
    (sentence,) = warn_of_unknowns(unknowns)
    check_sentence(sentence, "thickness of glass", "place of the wall")
    assert "tilt" not in sentence
    tilts = [f"tilt of the wall about {axis}" for axis in "XY"]
    assert [one.name for one in unknowns if one.shown] == tilts


def test_known_cameras_have_no_unknown_lenses() -> None:
    faulty: list[tuple[Unknown, ...]] = [("wall", "k1"), ()]
    for unknown in faulty:
        with refused("unknown"):
            solve(known_case(unknown)[0])


def test_gradients_are_those_of_the_cost() -> None:
    case, _, places = make_tank(bend_mm=0.5)
    free = FreeParameters(True, ("k1",), (2,), (0,), wall=True, bend=True)
    start = replace(with_places(case, places), initial_mm=places + 0.3)
    problem = CalibrationProblem.from_case(start, free)
    shared = np.array([0.0, 1e-3, 1e-3, -2e-3, 1e-3, 0.1, 0.2, -0.1])
    steps = 3 * ([1e-6] * 3 + [1e-4] * 3 + [1e-3] * 3 + [1e-6])
    steps += [1e-6, 1e-5, 1e-7, 1e-7, 1e-4, 1e-5, 1e-5, 1e-5]
    gradient, numeric, _ = slopes_of(problem, free, shared, steps)
    assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-3 * np.abs(gradient).max())


def test_a_wall_that_is_elsewhere_is_found_by_known_places() -> None:
    case, _, places = make_tank()
    wall = replace(WALL, point_mm=(0.0, 0.0, -40.0), normal=LEANING)
    off = replace(case, cameras=tuple(replace(camera, wall=wall) for camera in case.cameras))
    off = replace(with_places(off, places), unknown=("wall",))
    answer: Any = solve(off)
    found = answer.cameras[0].wall
    assert abs(found.depth_of(np.array([0.0, 0.0, 0.0]))) < 1.0
    assert found.normal[2] > np.cos(np.deg2rad(0.2))
    assert_allclose(answer.points_mm, places, atol=0.03)


def test_a_bent_board_is_found() -> None:
    case, _, places = make_tank(bend_mm=0.3)
    case = replace(case, initial_mm=place_boards(case))
    problem = CalibrationProblem.from_case(case, FreeParameters(bend=True))
    flat = fit_jointly(problem, FreeParameters())
    bent = fit_jointly(problem, FreeParameters(bend=True))
    assert flat.noise_px > 0.08
    assert bent.noise_px == pytest.approx(0.05, rel=0.1)
    assert_allclose(bent.fit.state.bend, [-0.3, 0.0, -0.3], atol=0.02)
    own = bent.fit.state.points(problem.seen.board)[0]
    apart = [np.linalg.norm(one[0] - one[-1]) for one in (own, places[0])]
    assert apart[0] == pytest.approx(apart[1], abs=1e-3)
