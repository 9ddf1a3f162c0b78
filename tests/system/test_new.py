"""Templates of repositories: their own tests pass in a fresh folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sabench.cli.new import KINDS
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


@pytest.mark.parametrize("kind", KINDS)
def test_the_tests_of_a_template_pass(kind: str, command: Command, tmp_path: Path) -> None:
    done = command("new", kind, "repository")
    assert done.stdout == f"repository: template of a {kind}; read README.md\n", done.stderr
    folder = tmp_path / "repository"
    assert (folder / ".github" / "workflows" / "sabench.yml").is_file()
    if kind != "suite":
        first = own_tests(folder, "-k", "worse")
        assert first.returncode == 1
        assert "baseline.json" in first.stdout
        assert own_tests(folder, "--sabench-update", "-k", "worse").returncode == 0
    passed = own_tests(folder)
    assert passed.returncode == 0, passed.stdout
    if kind == "solver":
        read_card(folder / "card.toml")
        solver = folder / "plugins" / "solvers" / "mine.py"
        text = solver.read_text(encoding="utf-8")
        worse = text.replace("volume[volume < self.parameters.floor] = 0.0", "volume[::2] = 0.0")
        solver.write_text(worse, encoding="utf-8")
        assert own_tests(folder, "-k", "worse").returncode == 1


def test_a_folder_that_is_there_is_kept(command: Command, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    assert command("new", "solver", "here").returncode == 2
    assert list((tmp_path / "here").iterdir()) == []
    done = command("new", "solvers", "there")
    assert done.returncode == 2
    assert "expected one of solver, suite, gate, got 'solvers'" in done.stderr
