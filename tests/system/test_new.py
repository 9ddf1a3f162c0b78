"""Templates of repositories: their own tests pass in a fresh folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sabench.evaluation.solver_card import read_card
from tests.conftest import ROOT, Command


def own_tests(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the tests of a repository as its author does."""
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def made(command: Command, tmp_path: Path) -> Callable[[str], Path]:
    """Make a repository of a kind in a fresh folder."""

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
    done = own_tests(folder)
    assert done.returncode == 0, done.stdout


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
    assert command("new", "solver", "here").returncode == 2
    assert list((tmp_path / "here").iterdir()) == []
    done = command("new", "solvers", "there")
    assert done.returncode == 2
    assert "expected one of scene, solver, suite, gate, got 'solvers'" in done.stderr


def test_a_scene_is_the_bundled_one(command: Command, tmp_path: Path) -> None:
    done = command("new", "scene", "tank.toml", "--like", "cylinder-tank")
    assert done.stdout == "tank.toml: the scene cylinder-tank, to be changed\n", done.stderr
    bundled = ROOT / "scenes" / "cylinder-tank.toml"
    assert (tmp_path / "tank.toml").read_bytes() == bundled.read_bytes()
    assert command("new", "scene", "tank.toml").returncode == 2
    assert (tmp_path / "tank.toml").read_bytes() == bundled.read_bytes()
    assert command("new", "scene", "quick.toml").returncode == 0
    wrong = command("new", "solver", "mine", "--like", "quick")
    assert wrong.returncode == 2
    assert "--like: expected with a scene" in wrong.stderr
