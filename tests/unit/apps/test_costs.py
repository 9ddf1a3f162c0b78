"""Costs of commands before they start: dry runs, notices, refusals."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

import sabench
from sabench.apps import costs
from sabench.apps.costs import Costs, announce, cost_of_generation, cost_of_solving
from sabench.cli.main import app
from sabench.scenes import build_rig, load_scene
from tests.helpers.refusals import refused

SAMPLES = ["generate", "quick", "--samples", "20"]  # 12.288 MB of grey values


@pytest.mark.parametrize(
    "words",
    [["generate", "quick", "--backend", "splat"], SAMPLES, ["reproduce", "fig-2-4"]],
)
def test_a_dry_run_writes_nothing(words: list[str], tmp_path: Path) -> None:
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "new"), "--dry-run"])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith(f"{tmp_path / 'new'}: time ")
    assert not list(tmp_path.iterdir())


def test_a_disk_that_is_too_small_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=12_300_000))
    with refused("free disk space", "13 MB", "12 MB"):
        CliRunner().invoke(app, [*SAMPLES, "-o", str(tmp_path / "new")], catch_exceptions=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("above", "below"),
    [
        (Costs(61.0), Costs(59.0)),
        (Costs(memory=1.1e9), Costs(memory=0.9e9)),
        (Costs(disk=1.1e9), Costs(disk=0.9e9)),
    ],
)
def test_one_line_is_printed_above_a_minute_or_a_gigabyte(
    above: Costs, below: Costs, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    announce(below, tmp_path / "new", dry_run=False)
    assert capsys.readouterr().err == ""
    announce(above, tmp_path / "new", dry_run=False)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_estimated_size_is_that_of_the_data_set(tmp_path: Path) -> None:
    scene = load_scene("quick").with_frames(2)
    expected = cost_of_generation(scene, 1, "splat", 1, exact=True).disk
    data = sabench.generate(scene, tmp_path / "data", seed=1, backend="splat")
    stored = sum(path.stat().st_size for path in data.root.rglob("*") if path.is_file())
    assert 0.7 * stored < expected < 1.3 * stored


def test_seconds_of_a_solver_are_those_of_its_records_on_this_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(costs, "_measure_reference", lambda: (0.0, 0.02))
    head = {"solver": "msa", "parameters": {}, "task": "particles", "scene_hash": "a"}
    record = {**head, "scene": "private", "seconds": 3.0, "reference_s": 0.01, "peak_mb": 5.0}
    optics = build_rig(load_scene("quick"), "quick")
    assert cost_of_solving([record], head, optics, 2) == Costs(12.0, 5e6)
    assert cost_of_solving([], head, optics, 2) == Costs(0.0, None, unknown=True)
