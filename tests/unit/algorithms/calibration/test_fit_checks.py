"""End states of calibrations: those that cannot be are named, and left by other starts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import calibration_reality
from sabench.algorithms.calibration import joint_fit
from sabench.algorithms.calibration.fit_checks import list_faults
from sabench.algorithms.calibration.joint_fit import fit_jointly
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.algorithms.calibration.resection import place_boards
from sabench.api.make import make_algorithm
from tests.helpers.calibration_tanks import make_tank, off_wall, solve, with_places
from tests.helpers.refusals import check_sentence, refused


def problem_of() -> tuple[CalibrationProblem, State]:
    case, cameras, places = make_tank()
    problem = CalibrationProblem.from_case(
        replace(case, cameras=cameras, initial_mm=places), FreeParameters()
    )
    return problem, problem.start


@pytest.mark.parametrize(
    ("part", "place", "value", "key"),
    [
        ("thicknesses", 0, -279.0, "glass"),
        ("indices", 2, 0.5, "fluid"),
        ("lenses", (1, 0), -50.0, "camera_01"),
        ("centers", (1, 2), 40.0, "camera_01"),
        ("board_positions", (2, 2), -70.0, "frame 2"),
        ("board_rotations", (0, 0, 0), np.nan, "board_rotations"),
    ],
)
def test_what_cannot_be_is_named(part: str, place: Any, value: float, key: str) -> None:
    problem, state = problem_of()
    values = getattr(state, part).copy()
    values[place] = value
    assert list_faults(state, problem.seen, problem.frame) == []
    (fault,) = list_faults(replace(state, **{part: values}), problem.seen, problem.frame)
    check_sentence(fault, key)


def test_a_start_through_the_wall_is_left() -> None:
    case, _, places = make_tank()
    through = places * [1.0, 1.0, -1.0] + [0.0, 0.0, 8.0]  # mirrored at the glass
    problem = CalibrationProblem.from_case(replace(case, initial_mm=through), FreeParameters())
    assert list_faults(problem.start, problem.seen, problem.frame)
    found = fit_jointly(problem, FreeParameters())
    assert list_faults(found.fit.state, problem.seen, problem.frame) == []
    assert found.noise_px == pytest.approx(0.05, rel=0.1)


def test_a_negative_glass_is_refused() -> None:
    """A wall that is elsewhere drives the thickness of its glass far below zero."""
    case, _, places = make_tank()
    with refused("glass"):
        solve(off_wall(with_places(case, places), -50.0), thicknesses=[0])


def test_a_free_glass_stays_near_its_nominal_thickness() -> None:
    """Images without a model's error say little of it, which the prior shows."""
    case, _, _ = make_tank()
    camera: Any = solve(case, thicknesses=[0]).cameras[0]
    assert camera.wall.layers[0].thickness_mm == pytest.approx(8.0, abs=6.0)


@pytest.mark.parametrize(
    ("name", "value"), [("thicknesses", [1]), ("indices", [-1]), ("wall", True)]
)
def test_unknown_layers_and_walls_are_named(name: str, value: Any) -> None:
    with refused(name):
        solve(make_tank()[0], **{name: value})


def test_a_depth_that_images_put_into_the_wall_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images so coarse that their best depth is in the wall, from every start."""
    case, _, _ = make_tank()
    case = replace(case, initial_mm=place_boards(case))
    problem = CalibrationProblem.from_case(case, FreeParameters())
    monkeypatch.setattr(joint_fit, "_is_sound", lambda *_: False)
    found = fit_jointly(problem, FreeParameters())
    assert found.held == "initial guess"
    depths = problem.frame.points(found.fit.state, problem.seen.board)[..., 2].mean()
    assert depths == pytest.approx(case.initial_mm[..., 2].mean(), rel=0.05)


@pytest.mark.slow
def test_a_richer_model_answers_rather_than_the_guess() -> None:
    """Taken for flat, the bent boards end in the wall; the guess is 30 mm too deep."""
    errors = calibration_reality.TANKS["all of these, near the wall, depth unknown"]
    tank = calibration_reality.make_tank(errors, seed=40)
    case = calibration_reality.guess(tank.case, seed=40)
    problem = CalibrationProblem.from_case(case, FreeParameters())
    assert fit_jointly(problem, FreeParameters()).held == "richer model"
    true = tank.points_mm[..., 2].mean()
    assert case.initial_mm[..., 2].mean() > true + 30.0
    solver: Any = make_algorithm("refractive_autocal", {})
    answer = solver.solve(case)
    assert answer.points_mm[..., 2].mean() == pytest.approx(true, abs=3.0)
    check_sentence(answer.remarks[0])
