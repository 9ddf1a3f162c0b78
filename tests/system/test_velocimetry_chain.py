"""Velocimetry from double frames to a field, its scores and its row on the page."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tomli_w

from sabench.api import Velocity
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.tasks.velocimetry import TASK, score_pair
from tests.conftest import Command
from tests.helpers.commands import local_page, refuse, succeed
from tests.system.test_board import block

SETTINGS = {"window": (24, 24, 24), "first_window": (32, 32, 32)}


def vortex_scene(**changes: Any) -> Scene:
    """Nine cameras look at a small vortex of 3 voxels' motion."""
    values = load_scene("array-9").to_dict()
    values["cameras"] |= {"rows": 160, "columns": 160, "particle_sigma_px": 0.8}
    values["volume"] |= {"size_mm": [8.0, 8.0, 4.0]}
    values["grid"] |= {"crop_mm": [0.5, 0.5, 0.0], "voxel_mm": [0.05, 0.05, 0.05]}
    values["particles"] = {"generator": "uniform", "per_pixel": 0.03, "diameter_mm": 0.02}
    values["flow"] = {"generator": "lamb_oseen_vortex", "core_mm": 1.5, "circulation_mm2_s": 2216.0}
    values |= {"frames": 4, "timing": {"rate_hz": 10.0, "pulses_s": [0.0, 0.001]}}
    return parse_scene(values | changes, "vortex")


@pytest.fixture(scope="module")
def vortex(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("vortex") / "data"
    return generate(vortex_scene(), folder, seed=1, backend="splat")


@pytest.mark.slow
def test_a_pair_becomes_a_field_and_scores(vortex: Dataset, tmp_path: Path) -> None:
    own = {"reconstruction": "mlos_smart", **SETTINGS}
    made = solve("piv3d", vortex, tmp_path / "result.h5", parameters=own)
    assert made.task == "velocimetry"
    assert made.reconstruction_s is not None
    field = open_result(tmp_path / "result.h5", vortex).read(Velocity, 2)
    assert field.valid.mean() > 0.9
    assert np.linalg.norm(field.velocity_mm_s, axis=-1).max() == pytest.approx(150.0, rel=0.25)
    scores = score(vortex, tmp_path / "result.h5")
    assert scores["u_p90_voxel"] < 0.35
    assert scores["v_p90_voxel"] < 0.35
    # of 80 planes, windows of 24 leave out 8 at either end
    assert 70.0 < scores["yield_percent"] < 80.0
    assert scores["vorticity_percent"] < 50.0
    assert scores["reconstruction_s"] > 0.0


@pytest.mark.parametrize(("low_mm", "valid"), [((0.0, 0.0, 0.0), False), ((1e5, 1e5, 0.0), True)])
def test_a_field_without_vectors_has_no_figures(
    low_mm: tuple[float, float, float], valid: bool, vortex: Dataset
) -> None:
    there = np.full((4, 4, 4), valid, dtype=np.bool_)
    field = Velocity(low_mm, (1.0, 1.0, 1.0), np.zeros((4, 4, 4, 3)), there)
    scores = score_pair(vortex, (0, 1), field)
    assert scores["yield_percent"] == 0.0
    assert np.isnan(scores["rms_voxel"])
    assert TASK.rank(scores) == TASK.rank({"rms_voxel": None})


def test_vectors_that_are_left_out_cost_the_yield(vortex: Dataset) -> None:
    whole = TASK.truth(vortex, 0)
    upper = np.zeros_like(whole.valid)
    upper[: len(upper) // 3] = True
    scores = score_pair(vortex, (0, 1), replace(whole, valid=upper))
    assert scores["yield_percent"] == pytest.approx(100.0 * upper.mean())
    assert scores["rms_voxel"] == 0.0
    worse = replace(whole, velocity_mm_s=0.9 * whole.velocity_mm_s)
    assert TASK.rank(score_pair(vortex, (0, 1), worse)) < TASK.rank(scores)


@pytest.mark.parametrize("wrong", ["v and w at rest", "v and w swapped", "v reversed"])
def test_a_field_that_is_right_along_x_only_does_not_lead(wrong: str, vortex: Dataset) -> None:
    truth = TASK.truth(vortex, 0)
    changes = {
        "v and w at rest": truth.velocity_mm_s * [1.0, 0.0, 0.0],
        "v and w swapped": truth.velocity_mm_s[..., [0, 2, 1]],
        "v reversed": truth.velocity_mm_s * [1.0, -1.0, 1.0],
    }
    scores = score_pair(vortex, (0, 1), replace(truth, velocity_mm_s=changes[wrong]))
    slow = replace(truth, velocity_mm_s=0.95 * np.asarray(truth.velocity_mm_s))
    fair = score_pair(vortex, (0, 1), slow)
    assert scores["u_p90_voxel"] == 0.0 < fair["u_p90_voxel"]
    assert TASK.rank(fair) < TASK.rank(scores)


@pytest.mark.slow
def test_one_command_and_the_page(command: Command, tmp_path: Path) -> None:
    (tmp_path / "vortex.toml").write_text(vortex_scene(frames=2).to_toml(), encoding="utf-8")
    (tmp_path / "suite.toml").write_text(
        'title = "t"\nbackend = "splat"\nscenes = ["vortex.toml"]\n'
        '[[solvers]]\nname = "piv3d"\n'
        'parameters = { reconstruction = "mlos_smart", window = [24, 24, 24], first_window = '
        "[32, 32, 32] }\n"
    )
    (record,) = json.loads(succeed(command("run", "suite.toml", "--json")).stdout)
    assert record["task"] == "velocimetry"
    assert record["u_p90_voxel"] < 0.4
    page = local_page(tmp_path)
    assert block(page)["rows"][0]["scores"][0] == [pytest.approx(record["rms_voxel"], rel=1e-8)]
    assert block(page)["tasks"]["velocimetry"]["pictured"]["heading"] == "Fields"
    # particles are no truth to show beside fields
    assert set(block(page, "album0")) == {"images", "row0"}
    data = open_dataset(next((tmp_path / "work" / "datasets").iterdir()))
    assert data.setup.times_s == (0.0, 0.001)


def test_volumes_smaller_than_a_window_are_named(vortex: Dataset, command: Command) -> None:
    own = ("-p", "reconstruction=asa", "-p", "window=[320,32,16]")
    refuse(command("solve", "piv3d", vortex.root, "-o", "result.h5", *own), "window")


def test_a_flow_without_units_is_named_and_leaves_nothing(tmp_path: Path, command: Command) -> None:
    axis = np.linspace(-20.0, 20.0, 8)
    with h5py.File(tmp_path / "dns.h5", "w") as file:
        for name in "xyz":
            file[name] = axis
        for name in "uvw":
            file[name] = np.ones((8, 8, 8))
    flow = {"generator": "from_field", "file": "dns.h5", "length": "mm"}
    text = tomli_w.dumps(vortex_scene(frames=1).to_dict() | {"flow": flow})
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    words = ("generate", "scene.toml", "-o", "data", "--backend", "splat")
    refuse(command(*words), "dns.h5: u", "flow.speed")
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
def test_volumes_that_show_nothing_are_named(tmp_path: Path, command: Command) -> None:
    scene = vortex_scene(frames=2, particles={"generator": "uniform", "count": 0})
    generate(scene, tmp_path / "data", seed=1, backend="splat")
    words = ("solve", "piv3d", "data", "-o", "result.h5", "-p", "reconstruction=asa")
    refuse(command(*words), "first volume")
    assert not (tmp_path / "result.h5").exists()
