"""Scores without the renderer and without the libraries of figures and of the page."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import sabench
from sabench.dataset.reader import Dataset
from tests.conftest import ROOT

MODULES = {
    "opencv-python-headless": "cv2",
    "scikit-image": "skimage",
    "openexr": "OpenEXR",
    "vl-convert-python": "vl_convert",
}
SCRIPT = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {missing!r}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Missing())
import sabench.evaluation.challenge.score, sabench.interop.import_results
from sabench.cli.main import main
sys.argv = ["sabench", "score", {data!r}, {result!r}, "--json"]
main()
"""


def left_out() -> set[str]:
    """Modules of the dependencies that `score-requirements.txt` leaves out."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    every = {re.split(r"[>;]", one)[0] for one in tomllib.loads(text)["project"]["dependencies"]}
    light = (ROOT / "score-requirements.txt").read_text(encoding="utf-8").splitlines()
    names = {one.lower() for one in every} - {re.split(r"[>;]", one)[0].lower() for one in light}
    return {MODULES.get(name, name.replace("-", "_")) for name in names}


def test_scores_need_no_renderer(quick: Dataset, quick_result: Path) -> None:
    missing = left_out()
    assert {"mitsuba", "drjit", "cv2", "OpenEXR", "jinja2", "matplotlib"} <= missing
    script = SCRIPT.format(missing=missing, data=str(quick.root), result=str(quick_result))
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == sabench.score(quick, quick_result)
