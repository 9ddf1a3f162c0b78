"""Calibration solvers: duties, accuracy, and the chain from a scene to the page."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench import plugins
from sabench.api import Calibration, CalibrationCase
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset
from sabench.scenes import parse_scene
from sabench.tasks.calibration import TASK
from tests.conftest import Command
from tests.helpers.calibration_cases import calibration_scene, case_of, true_error_px
from tests.helpers.commands import local_records
from tests.helpers.refusals import check_sentence, refused
from tests.system.test_board import solvers
from tests.unit.algorithms.calibration.test_self_calibration import particle_scene

SOLVERS = [
    name
    for name in plugins.names("solvers")
    if getattr(plugins.load("solvers", name), "sees", "") == "target"
]
LEVEL = {"tilt_deg": 0.0, "roll_deg": 0.0, "wander": 0.3}
KNOWN = [{"frame": 3, "point": 60, "sigma_mm": 0.02}]


def solved(name: str, case: CalibrationCase) -> Calibration:
    algorithm: Any = make_algorithm(name, {})
    assert algorithm.skip(case) is None
    made: Calibration = algorithm.solve(case)
    return made


def level_case(**changes: Any) -> Any:
    rough = {"points": 0.0002, "known": KNOWN}
    return case_of(calibration_scene(targets=LEVEL, frames=7, calibration=rough, **changes))


# Mean true reprojection error, px, where points are found to 0.1 px and known to 0.01 mm (0.2 px);
# linear_autocal cannot know of the wall.
MOST = {
    "refractive_autocal": 0.015,
    "refractive_autocal_alternating": 0.1,
    "refractive_resection": 0.1,
    "refractive_autocal_randomised": 0.1,
    "soloff": 0.1,
    "polynomial_planes": 0.15,
    "pinhole_linear": 0.3,
    "plane_parallax": 0.4,  # warns of the wall
    "linear_autocal": 60.0,
}


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", SOLVERS)
def test_a_solver_calibrates_accurately(name: str) -> None:
    """Test accuracy; repetition is tested by test_conformance."""
    case, _, points, exact = level_case()
    answer = solved(name, case)
    assert [camera.name for camera in answer.cameras] == [camera.name for camera in case.cameras]
    places = points if answer.points_mm is None else answer.points_mm
    assert true_error_px(answer.cameras, places, exact) < MOST[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_missing_points_and_hidden_boards_are_normal(name: str) -> None:
    case, _, points, exact = level_case(detection={"noise_px": 0.1, "missing": 0.1, "hidden": 0.2})
    assert 0.6 < case.found.mean() < 0.9
    answer = solved(name, case)
    places = points if answer.points_mm is None else answer.points_mm
    # polynomials go on into what is hidden
    assert true_error_px(answer.cameras, places, exact) < 3.0 * MOST[name]


@pytest.mark.parametrize("name", SOLVERS)
def test_a_camera_that_sees_nothing_is_named(name: str) -> None:
    case, *_ = level_case()
    pixels = case.pixels.copy()
    pixels[2] = np.nan
    with refused("camera_02"):
        solved(name, replace(case, pixels=pixels))


@pytest.mark.parametrize(
    ("name", "blank"),
    [
        *(("polynomial_planes", False), ("polynomial_planes", True)),
        *(("soloff", True), ("pinhole_linear", True)),
    ],
)
def test_classical_calibrations_need_planes_or_different_depths(name: str, blank: bool) -> None:
    changes = {"calibration": {"blank": True, "known": []}} if blank else {}
    algorithm: Any = make_algorithm(name, {})
    check_sentence(algorithm.skip(case_of(calibration_scene(**changes))[0]))


@pytest.mark.slow
def test_alternation_ends_early_and_joint_adjustment_does_not() -> None:
    """The thesis's alternation stops at a change of 0.001 px, before least squares."""
    rough = {"points": 0.2, "center_mm": 30.0, "turn_deg": 3.0, "known": []}
    case, _, _, exact = case_of(calibration_scene(calibration=rough))
    errors = {}
    for name in ("refractive_autocal", "refractive_autocal_alternating"):
        answer = solved(name, case)
        assert answer.points_mm is not None
        errors[name] = true_error_px(answer.cameras, answer.points_mm, exact)
    assert errors["refractive_autocal"] < 0.015
    assert errors["refractive_autocal_alternating"] > 3.0 * errors["refractive_autocal"]


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("calibration") / "boards"
    return sabench.generate(calibration_scene(), folder, seed=2, backend="splat", name="boards")


def test_both_ends_of_the_scale(boards: Dataset) -> None:
    truth, empty = sabench.score(boards, "truth"), sabench.score(boards, "empty")
    assert truth["true_px"] == pytest.approx(0.0, abs=1e-9)
    assert truth["measured_px"] == pytest.approx(0.1 * np.sqrt(np.pi / 2.0), rel=0.05)
    assert truth["held_out_mm"] == pytest.approx(truth["held_out_exact_mm"])
    for how in ("", "raw_", "shift_", "rigid_"):
        keys = [f"{how}{axis}_{what}_mm" for axis in "xyz" for what in ("mean", "std")]
        assert max(abs(truth[key]) for key in keys) < 1e-9
    assert empty["true_px"] > 20.0
    assert empty["held_out_mm"] > 10.0 * truth["held_out_mm"]


def test_a_calibration_s_scores(boards: Dataset, tmp_path: Path) -> None:
    result = sabench.solve("refractive_autocal", boards, tmp_path / "r.h5")
    assert result.task == "calibration"
    scores = sabench.score(boards, result.path)
    assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    assert scores["true_ratio"] == pytest.approx(1.0, abs=0.25)
    assert scores["efficiency_ratio"] == pytest.approx(1.0, abs=0.25)
    assert scores["used_percent"] > 99.0
    assert scores["z_std_mm"] < 0.02
    assert scores["rigid_z_std_mm"] <= scores["z_std_mm"] + 1e-9
    assert scores["held_out_mm"] < 1.5 * scores["held_out_exact_mm"]
    again = result.read(Calibration)
    assert again.points_mm is not None
    assert again.points_mm.shape == (5, 121, 3)


@pytest.mark.slow
def test_a_wrong_index_is_estimated_and_scored(boards: Dataset, tmp_path: Path) -> None:
    """Of the wall, only the fluid's index is estimated; fixed parameters stay exact."""
    own = {"indices": [2]}
    result = sabench.solve("refractive_autocal", boards, tmp_path / "r.h5", parameters=own)
    scores = sabench.score(boards, result.path)
    assert 0.0 < scores["index_error"] < 0.01
    assert scores["thickness_error_mm"] == 0.0


def test_a_solver_of_other_kind_is_refused(boards: Dataset, quick: Dataset, tmp_path: Path) -> None:
    for solver, data in (("msa", boards), ("soloff", quick)):
        with refused(solver):
            sabench.solve(solver, data, tmp_path / "r.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_self_calibration_is_scored_on_particles(tmp_path: Path) -> None:
    data = sabench.generate(
        particle_scene(2.0), tmp_path / "set", seed=3, backend="splat", name="particles"
    )
    result = sabench.solve("volume_self_calibration", data, tmp_path / "r.h5")
    assert TASK.score(data, "truth")["true_px"] == pytest.approx(0.0, abs=1e-6)
    empty = TASK.score(data, "empty")["true_px"]
    assert empty is not None
    assert empty > 1.0
    assert sabench.score(data, result.path)["true_px"] < 0.06


@pytest.mark.slow
def test_a_suite_of_calibrations_leaves_a_page(command: Command, tmp_path: Path) -> None:
    values = calibration_scene(
        targets={"columns": 7, "rows": 7}, calibration={"known": []}
    ).to_dict()
    (tmp_path / "boards.toml").write_text(parse_scene(values, "s").to_toml())
    names = ("refractive_autocal", "soloff", "polynomial_planes")
    own = ", ".join(f'{{ name = "{name}" }}' for name in names)
    head = 'title = "t"\nscenes = ["boards.toml"]\nseeds = [1, 2]\nbackend = "splat"\n'
    (tmp_path / "suite.toml").write_text(f"{head}solvers = [{own}]\n")
    done = command("run", "suite.toml")
    # polynomial_planes declines tilted boards, which is no fault
    assert done.returncode == 0, done.stderr
    assert "polynomial_planes declines this case" in " ".join(done.stderr.split())
    records = local_records(tmp_path)
    assert [record["task"] for record in records] == ["calibration"] * 6
    assert [record["declined"] for record in records] == [False, False, True] * 2
    assert all(
        (record["true_px"] is None) == (record["solver"] == "polynomial_planes")
        for record in records
    )
    page = (tmp_path / "leaderboard/index.html").read_text(encoding="utf-8")
    assert "true / bound" in page
    assert solvers(page)[:2] == ["refractive_autocal", "soloff"]
    assert len(list((tmp_path / "leaderboard/pictures").rglob("*.png"))) == 4
