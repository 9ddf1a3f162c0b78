"""Cameras that see nothing: every --json prints strict JSON, or one sentence."""

import inspect
import json
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import sabench
from sabench.cli.main import app
from sabench.dataset.reader import Dataset
from tests.conftest import Command
from tests.helpers.calibration_cases import calibration_scene, case_of, write_points
from tests.helpers.commands import refuse, succeed
from tests.helpers.plug_ins import write_solver
from tests.system.test_calibrate import describe

HEAD = "from dataclasses import replace"
BEHIND = "replace(own, rotation=(np.diag([-1.0, 1.0, -1.0]) @ own.rotation).tolist())"
OUTSIDE = "replace(own, principal_point_px=(1e7, 1e7))"
WAYS = {
    "behind": (BEHIND, "case.initial_mm"),
    "behind_alone": (BEHIND, "None"),
    "outside": (OUTSIDE, "case.initial_mm"),
}
SUITE = """title = "t"
backend = "splat"
scenes = ["boards.toml"]
solvers = [{ name = "behind" }, { name = "behind_alone" }, { name = "outside" }]
"""
SCENE = calibration_scene(frames=3)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("boards") / "data"
    return sabench.generate(SCENE, folder, seed=1, backend="splat")


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, (camera, points) in WAYS.items():
        solve = f"return Calibration(tuple({camera} for own in case.cameras), {points})"
        write_solver(tmp_path / "plugins", name, solve, HEAD, "CalibrationSolver")
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path / "plugins"))


def read_strictly(text: str) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


def check_end(done: subprocess.CompletedProcess[str]) -> None:
    """A command prints strict JSON or one sentence."""
    if done.returncode == 2:
        assert done.stdout == ""
        refuse(done)
    else:
        assert done.returncode in (0, 1), done.stderr
        assert read_strictly(done.stdout)


@pytest.mark.slow_but_first
@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", WAYS)
def test_score_prints_json(command: Command, boards: Dataset, tmp_path: Path, name: str) -> None:
    made = sabench.solve(name, boards, tmp_path / "r.h5")
    done = succeed(command("score", boards.root, made.path, "--json"))
    scores = read_strictly(done.stdout)
    first = boards.setup.cameras[0]
    assert scores["true_px"] == pytest.approx(np.hypot(first.rows, first.columns))


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", WAYS)
def test_view_prints_json(command: Command, boards: Dataset, tmp_path: Path, name: str) -> None:
    made = sabench.solve(name, boards, tmp_path / "r.h5")
    done = succeed(command("view", boards.root, made.path, "--json"))
    assert read_strictly(done.stdout)["cameras"] == len(boards.setup.cameras)


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
def test_run_check_and_submit_print_json(command: Command, tmp_path: Path) -> None:
    (tmp_path / "boards.toml").write_text(SCENE.to_toml(), encoding="utf-8")
    (tmp_path / "suite.toml").write_text(SUITE)
    records = read_strictly(succeed(command("run", "suite.toml", "--json")).stdout)
    assert [one["error"] for one in records] == [None] * 3
    (result,) = (tmp_path / "work" / "results").glob("*-behind-*.h5")
    done = succeed(command("submit", result, "--name", "me", "--json"))
    assert len(read_strictly(done.stdout)) == 1
    check = ("check", "suite.toml", "--baseline", "b.json", "--solver", "behind", "--json")
    for words in (["--update"], []):
        done = succeed(command(*check, *words))
        assert read_strictly(done.stdout)["worse"] == []


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("words", ["conform behind_alone", "conform outside", "warmup behind"])
def test_conform_and_warmup_print_json(command: Command, words: str) -> None:
    done = command(*words.split(), "--json")
    assert done.returncode in (0, 1), done.stderr
    assert read_strictly(done.stdout)


@pytest.mark.slow
@pytest.mark.usefixtures("plugins")
@pytest.mark.parametrize("name", WAYS)
def test_calibrate_prints_json_or_one_sentence(command: Command, tmp_path: Path, name: str) -> None:
    case, cameras, *_ = case_of(SCENE)
    describe(SCENE, tmp_path / "mine", cameras)
    write_points(tmp_path / "mine" / "points.csv", case.pixels, cameras)
    done = command("calibrate", "mine", "--solver", name, "--json")
    check_end(done)
    assert (tmp_path / "mine" / "result").exists() == (done.returncode == 0)


@pytest.mark.usefixtures("plugins")
def test_list_and_refocus(command: Command, boards: Dataset) -> None:
    """Points of targets are no images to refocus."""
    done = command("list", "--json")
    assert set(WAYS) < {one["name"] for one in read_strictly(done.stdout)}
    refuse(command("refocus", boards.root, "-o", "wall", "--json"))


@pytest.mark.slow
@pytest.mark.parametrize("grey", [0, 255])
def test_commands_on_own_recordings_print_json_of_images_that_show_nothing(
    command: Command, quick: Dataset, tmp_path: Path, grey: int
) -> None:
    first = quick.setup.cameras[0]
    blank = np.full((first.rows, first.columns), grey, dtype=np.uint8)
    for camera in quick.setup.cameras:
        (tmp_path / "films" / camera.name).mkdir(parents=True)
        cv2.imwrite(str(tmp_path / "films" / camera.name / "0.png"), blank)
    asked = [
        ("compare-statistics", quick.root, "films", "--json"),
        ("import", "films", "--cameras", quick.root, "-o", "tank", "--json"),
        ("preprocess", "tank", "-o", "preview.png", "--json"),
        ("quality", "tank", "found.h5", "--no-again", "--json"),
        ("view", "tank", "found.h5", "--json"),
        ("plan", "quick", "--json"),
    ]
    for words in asked:
        if words[0] == "quality":
            succeed(command("solve", "ray_triangulation", "tank", "-o", "found.h5"))
        check_end(command(*words))


def test_every_command_with_json_is_tried_here() -> None:
    """All but `reproduce`, which takes neither solvers nor cameras of others."""
    with_json = {
        command.name or getattr(command.callback, "__name__", "")
        for command in app.registered_commands
        if "as_json" in inspect.signature(command.callback or len).parameters
    }
    tried = "calibrate check compare-statistics conform import list plan preprocess quality refocus"
    tried += " run score submit warmup view reproduce"
    assert with_json == set(tried.split())
