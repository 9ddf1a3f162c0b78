"""The plug-ins that CONTRIBUTING.md shows.

They run without changes for anybody who copies them.
"""

from __future__ import annotations

import ast
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sabench.api import Observation, Reconstruction
from sabench.api.make import make_solver
from sabench.scenes import load_scene
from sabench.simulation.in_memory import simulate
from tests.conftest import ROOT, Command
from tests.docs.pages import blocks

EXAMPLES = ROOT / "examples/plugins"
FILES = ("solvers/min_los.py", "generators/lattice.py")
ALLOWED = ("sabench.api", "sabench.algorithms")


def test_the_page_shows_the_solver() -> None:
    (shown,) = (one.text for one in blocks("CONTRIBUTING.md") if one.file == f"mine/{FILES[0]}")
    assert shown == (EXAMPLES / FILES[0]).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", FILES)
def test_a_plug_in_imports_public_names_only(name: str) -> None:
    tree = ast.parse((EXAMPLES / name).read_text(encoding="utf-8"))
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    own = [module for module in modules if module.split(".")[0] == "sabench"]
    assert own
    assert all(module.startswith(ALLOWED) for module in own)


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
        done = command(*words.split())
        assert done.returncode == 0, done.stderr
    assert command("verify", "data").returncode == 0
    scores = json.loads(command("score", "data", "found.h5", "--json").stdout)
    assert scores["parameters"] == {"floor": 0.1}
    assert scores["true_percent"] > 80.0


@pytest.fixture
def case(monkeypatch: pytest.MonkeyPatch) -> Observation:
    """Four cameras of the quick scene, with the examples among the plug-ins."""
    monkeypatch.setenv("SABENCH_PLUGINS", str(EXAMPLES))
    return simulate(load_scene("quick"), seed=5).observation


def solved(case: Observation) -> Reconstruction:
    return make_solver("min_los", {}).solve(case)


@pytest.mark.slow
def test_the_solver_obeys_the_laws_of_all_solvers(case: Observation) -> None:
    volume = solved(case).volume
    assert volume.dtype == np.float32
    assert volume.shape == case.grid.shape
    assert volume.min() == 0.0
    assert np.isfinite(volume).all()
    turned = replace(case, images=case.images[::-1].copy(), cameras=case.cameras[::-1])
    np.testing.assert_array_equal(solved(turned).volume, volume)
    dark = np.full_like(case.images, int(case.black_dn))
    assert not solved(replace(case, images=dark)).volume.any()


def test_one_camera_is_refused_with_a_reason(case: Observation) -> None:
    one = replace(case, images=case.images[:1], cameras=case.cameras[:1])
    assert make_solver("min_los", {}).skip(one)
    assert make_solver("min_los", {}).skip(case) is None
