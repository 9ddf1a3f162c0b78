"""A gate as users run it, from the command line and as a fixture of pytest."""

import json
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

# pytest within pytest forgets what it has loaded, and parts of these can be loaded only once
import numpy.fft  # noqa: F401
import pytest
import scipy.ndimage
import scipy.sparse.csgraph
import scipy.spatial  # noqa: F401

from tests.conftest import ROOT, Command
from tests.helpers.commands import refuse, succeed
from tests.helpers.plug_ins import write_solver

pytest_plugins = "pytester"

SUITE = """title = "tiny"
backend = "splat"
[[cases]]
scene = "quick"
name = "few"
solvers = [{ name = "dimmest" }]
[cases.set]
"volume.size_mm" = [7.0, 5.0, 2.0]
"particles.count" = 25
"""
HEAD = """
from sabench.images.levels import normalise
from sabench.algorithms.refocus import refocus_log2
"""
SOLVE = """
images = normalise(case.images, case.black_dn)
volume = refocus_log2(images, case.cameras, case.grid, 0.01, outside=0.01)
volume[volume < -8.0] = -100.0
return Reconstruction(2.0 ** volume)
"""
PLANTED = SOLVE.replace("case.cameras, case.grid", "case.cameras[::-1], case.grid")


@pytest.fixture
def algorithms(tmp_path: Path) -> Path:
    """A folder with a plug-in of somebody else and a suite."""
    write_solver(tmp_path / "mine", "dimmest", SOLVE, HEAD)
    (tmp_path / "tiny.toml").write_text(SUITE)
    return tmp_path


def plant(folder: Path) -> None:
    write_solver(folder / "mine", "dimmest", PLANTED, HEAD)
    sys.modules.pop("sabench.plugins.solvers.dimmest", None)


@pytest.mark.slow
def test_a_check_is_silent_until_something_got_worse(
    algorithms: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(algorithms / "mine"))
    words = ("check", "tiny.toml")
    refuse(command(*words), "--update")
    made = succeed(command(*words, "--update"))
    assert made.stdout == "tiny: 1 data sets, 1 results: baseline written to tiny.baseline.json\n"
    silent = command(*words, "--junit", "ok.xml")
    assert silent.returncode == 0, silent.stdout + silent.stderr
    assert silent.stdout == "tiny: 1 data sets, 1 results: nothing got worse\n"
    assert ElementTree.parse(algorithms / "ok.xml").getroot().get("failures") == "0"
    plant(algorithms)
    worse = command(*words, "--junit", "bad.xml", "--json")
    assert worse.returncode == 1
    figures = {one["figure"]: one for one in json.loads(worse.stdout)["worse"]}
    assert figures["q"]["solver"] == "dimmest"
    assert figures["q"]["now"] < figures["q"]["before"] - figures["q"]["tolerance"]
    assert ElementTree.parse(algorithms / "bad.xml").getroot().get("failures") == "1"


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("--baseline", ROOT / "leaderboard/baselines/ci.json"), "tiny"),
        (("--baseline", "base.json", "--update", "--solver", "piv3d"), "velocimetry"),
    ],
)
def test_what_is_not_of_the_suite_is_bad_input(
    algorithms: Path, command: Command, monkeypatch: pytest.MonkeyPatch, words: Any, key: str
) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", str(algorithms / "mine"))
    refuse(command("check", "tiny.toml", *words), key)


@pytest.mark.slow
def test_the_fixture_runs_a_plug_in_against_its_baseline(
    algorithms: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SABENCH_PLUGINS", "")  # the plug-in sets it, in this process
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeini(f"[pytest]\nsabench_plugins = {algorithms / 'mine'}\n")
    (pytester.path / "tiny.toml").write_text(SUITE)
    pytester.makepyfile(
        "def test_quality(sabench_check):\n"
        '    solvers = ["dimmest", {"name": "msa", "parameters": {"k": 2.0}}]\n'
        '    found = sabench_check("tiny.toml", "base.json", solvers=solvers)\n'
        '    assert list(found.now.cases[0].solvers) == ["dimmest", "msa k=2.0"]\n'
    )
    run = ("-p", "sabench.evaluation.gates.pytest_plugin", "-p", "no:cacheprovider")
    pytester.runpytest_inprocess(*run, "--sabench-update").assert_outcomes(passed=1)
    assert (pytester.path / "base.json").is_file()
    pytester.runpytest_inprocess(*run).assert_outcomes(passed=1)
    plant(algorithms)
    failed = pytester.runpytest_inprocess(*run)
    failed.assert_outcomes(failed=1)
    failed.stdout.fnmatch_lines(["*few, seed 1: dimmest: q: * before, * now*is allowed*"])
    (pytester.path / "base.json").unlink()
    missing = pytester.runpytest_inprocess(*run)
    missing.assert_outcomes(failed=1)
    missing.stdout.fnmatch_lines(["*base.json: expected*tiny*"])
    missing.stdout.no_fnmatch_line("*gates/baseline.py*")  # no traceback


def test_pytest_loads_no_sabench(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    heavy = (
        "{'mitsuba', 'drjit', 'numba', 'numpy', 'sabench.evaluation.gates.comparison', "
        "'sabench.plugins'}"
    )
    pytester.makepyfile(
        f"import sys\ndef test_light():\n    assert not {heavy} & set(sys.modules)\n"
    )
    pytester.runpytest_subprocess(
        "-p", "sabench.evaluation.gates.pytest_plugin", "-p", "no:hypothesispytest"
    ).assert_outcomes(passed=1)
