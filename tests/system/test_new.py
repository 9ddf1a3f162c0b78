"""Templates of repositories, and plug-ins that CONTRIBUTING.md shows."""

import json
import re
import shutil
import subprocess
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from sabench.api.make import make_solver
from sabench.evaluation.solver_card import read_card
from sabench.scenes import load_scene
from sabench.simulation.in_memory import simulate
from sabench.tasks import of
from sabench.tasks.conformance import check_solver
from tests.conftest import ROOT, Command
from tests.docs.pages import blocks
from tests.helpers.commands import refuse, run_python, succeed


def own_tests(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return run_python("-m", "pytest", "-q", *words, cwd=folder)


@pytest.fixture
def made(command: Command, tmp_path: Path) -> Callable[[str], Path]:
    def make(kind: str) -> Path:
        done = command("new", kind, "repository")
        assert done.stdout == f"repository: template of a {kind}; read README.md\n", done.stderr
        folder = tmp_path / "repository"
        assert (folder / ".github" / "workflows" / "sabench.yml").is_file()
        return folder

    return make


@pytest.mark.slow
def test_a_suite_passes_its_tests(made: Callable[[str], Path]) -> None:
    done = own_tests(made("suite"))
    assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_gate_passes_its_tests_when_its_baseline_is_written(made: Callable[[str], Path]) -> None:
    folder = made("gate")
    first = own_tests(folder)
    assert first.returncode == 1
    assert "baseline.json" in first.stdout
    assert own_tests(folder, "--sabench-update").returncode == 0
    done = own_tests(folder, "-rP")
    assert done.returncode == 0, done.stdout
    scores = [score.key for score in of("reconstruction").columns[:3]]
    assert re.search(rf"asa: {' [-.0-9]+, '.join(scores)} [-.0-9]+\n", done.stdout)


@pytest.mark.parametrize(
    ("kind", "suite"), [("gate", "tests/suite"), ("solver", "tests/suite"), ("suite", "mine")]
)
def test_a_workflow_warms_up_the_solvers_of_its_suite(kind: str, suite: str) -> None:
    folder = ROOT / "templates" / kind
    workflow = (folder / ".github" / "workflows" / "sabench.yml").read_text(encoding="utf-8")
    (warmed,) = re.findall(r"run: sabench warmup (.*)\n", workflow)
    solvers = tomllib.loads((folder / f"{suite}.toml").read_text(encoding="utf-8"))["solvers"]
    assert warmed.split() == [solver["name"] for solver in solvers]


@pytest.mark.slow
def test_a_solver_passes_its_tests_and_a_worse_one_does_not(made: Callable[[str], Path]) -> None:
    folder = made("solver")
    done = own_tests(folder, "--sabench-update")
    assert done.returncode == 0, done.stdout
    assert read_card(folder / "card.toml").solver == "mine"
    solver = folder / "plugins" / "solvers" / "mine.py"
    text = solver.read_text(encoding="utf-8")
    kept = "volume[volume < self.parameters.floor] = 0.0"
    solver.write_text(text.replace(kept, "volume[::2] = 0.0"), encoding="utf-8")
    assert own_tests(folder, "-k", "worse").returncode == 1


def test_a_folder_that_is_there_is_kept(command: Command, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    refuse(command("new", "solver", "here"), "here")
    assert list((tmp_path / "here").iterdir()) == []
    refuse(command("new", "solvers", "there"), "solvers")


def test_a_scene_is_the_bundled_one(command: Command, tmp_path: Path) -> None:
    done = command("new", "scene", "tank.toml", "--like", "cylinder-tank")
    assert done.stdout == "tank.toml: the scene cylinder-tank, to be changed\n", done.stderr
    bundled = ROOT / "scenes" / "cylinder-tank.toml"
    assert (tmp_path / "tank.toml").read_bytes() == bundled.read_bytes()
    refuse(command("new", "scene", "tank.toml"), "tank.toml")
    assert (tmp_path / "tank.toml").read_bytes() == bundled.read_bytes()
    assert command("new", "scene", "quick.toml").returncode == 0
    refuse(command("new", "solver", "mine", "--like", "quick"), "--like")


EXAMPLES = ROOT / "examples/plugins"
FILES = ("solvers/min_los.py", "generators/lattice.py")


def test_the_page_shows_the_solver() -> None:
    (shown,) = (one.text for one in blocks("CONTRIBUTING.md") if one.file == f"mine/{FILES[0]}")
    assert shown == (EXAMPLES / FILES[0]).read_text(encoding="utf-8")


@pytest.mark.slow
def test_copied_plug_ins_are_listed_run_and_scored(
    tmp_path: Path, command: Command, quick_toml: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path / "mine"))
    shutil.copytree(EXAMPLES, tmp_path / "mine")
    text = quick_toml.replace('generator = "uniform"\ncount = 300', 'generator = "lattice"')
    text = text.replace("diameter_spread = 0.1", "pitch_mm = 1.5\njitter_mm = 0.2")
    (tmp_path / "lattice.toml").write_text(text, encoding="utf-8")
    listed = command("list")
    assert not listed.stderr
    assert {"min_los", "lattice"} <= {line.split()[1] for line in listed.stdout.splitlines()}
    for words in (
        "generate lattice.toml -o data --seed 1 --backend splat",
        "solve min_los data -o found.h5 -p floor=0.1",
    ):
        succeed(command(*words.split()))
    assert command("verify", "data").returncode == 0
    scores = json.loads(command("score", "data", "found.h5", "--json").stdout)
    assert scores["parameters"] == {"floor": 0.1}
    assert scores["true_percent"] > 80.0
    assert not [one for one in check_solver("min_los") if one.verdict == "broken"]


def test_one_camera_is_refused_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(EXAMPLES))
    case = simulate(load_scene("quick"), seed=5).observation
    one = replace(case, images=case.images[:1], cameras=case.cameras[:1])
    assert make_solver("min_los", {}).skip(one)
    assert make_solver("min_los", {}).skip(case) is None
