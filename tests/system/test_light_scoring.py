"""Scores without the packages of the extra `full`: no renderer, no figures."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

import sabench
from sabench.dataset.reader import Dataset
from sabench.utils.installed import FULL
from tests.conftest import ROOT
from tests.helpers.commands import run_python, succeed

SCRIPT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {missing!r}:
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Missing())
import sabench.apps.challenge.score, sabench.interop.tracks
from sabench.cli.main import main
sys.argv = ["sabench", *{words!r}]
main()
"""
MODULES = {
    "opencv-python-headless": "cv2",
    "scikit-image": "skimage",
    "vl-convert-python": "vl_convert",
    "karellen-llvm-core": None,  # a library, no module
}


def call(*words: str) -> subprocess.CompletedProcess[str]:
    return run_python("-c", SCRIPT.format(missing=set(FULL), words=words))


def test_the_missing_modules_are_those_of_the_extra() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(text)["project"]
    full = (re.split(r"[>;]", one)[0] for one in project["optional-dependencies"]["full"])
    modules = {MODULES.get(name, name.replace("-", "_")) for name in full} - {None}
    assert modules == FULL
    assert project["optional-dependencies"]["score"] == []


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, "ray_triangulation"])
def test_scores_are_those_with_all_packages(
    solver: str | None, quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    if solver is not None:
        quick_result = sabench.solve(solver, quick, tmp_path / "result.h5").path
    done = succeed(call("score", str(quick.root), str(quick_result), "--json"))
    assert json.loads(done.stdout) == sabench.score(quick, quick_result)


@pytest.mark.slow
def test_what_needs_more_says_so(tmp_path: Path) -> None:
    out = tmp_path / "data"
    done = call("generate", "quick", "-o", str(out))
    assert done.returncode == 2
    assert "pip install 'sabench[full]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists()
