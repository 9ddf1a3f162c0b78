"""Light sheets of data sets, and the flow averaged over them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.api import Velocity
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result, result_writer
from sabench.evaluation.suite_loading import override
from sabench.plugins import bundled_folder
from sabench.scenes import Scene, load_scene
from sabench.simulation.pipeline import generate
from sabench.tasks import velocimetry
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64

CONFORMANCE = bundled_folder("scenes") / "conformance"


def scene_of(name: str, changes: dict[str, Any]) -> Scene:
    return override(load_scene(CONFORMANCE / f"{name}.toml"), changes, name)


def data_of(tmp_path: Path, changes: dict[str, Any], name: str = "") -> Dataset:
    scene = scene_of(name or "velocimetry_by_light_sheet", changes)
    generate(scene, tmp_path / "data", seed=1, backend="splat")
    return open_dataset(tmp_path / "data")


def sheet_of(data: Dataset) -> velocimetry.LightSheet:
    sheet = velocimetry.light_sheet(data)
    assert sheet is not None
    return sheet


@pytest.mark.parametrize("profile", ["top-hat", "gaussian"])
def test_the_average_is_that_over_the_light(profile: str, tmp_path: Path) -> None:
    light = {"illumination.profile": profile, "illumination.thickness_mm": 0.8}
    sheet = sheet_of(data_of(tmp_path, light))

    def velocity(points: F64) -> F64:
        z = points[:, 2]
        return np.column_stack([z**2, 1.0 + z**3 - 2.0 * z**4, z**6])

    z = np.linspace(-2.0, 2.0, 200_001)
    weight = np.exp(-8.0 * (z / 0.8) ** 2) if profile == "gaussian" else np.abs(z) <= 0.4
    points = np.column_stack([0.0 * z, 0.0 * z, z])
    expected = np.average(velocity(points), axis=0, weights=weight)
    np.testing.assert_allclose(sheet.average(velocity, np.zeros((1, 3)))[0], expected, rtol=1e-3)


def test_the_sheet_is_where_the_pulses_are(tmp_path: Path) -> None:
    changes = {"illumination.shift_mm": 0.2, "timing.shift_mm": [0.0, 0.1]}
    sheet = sheet_of(data_of(tmp_path, changes | {"illumination.sheet_normal": [0.0, 0.6, 0.8]}))
    np.testing.assert_allclose(sheet.normal, [0.0, 0.6, 0.8])
    np.testing.assert_allclose(sheet.point_mm, 0.25 * sheet.normal)


def test_light_of_a_volume_is_no_sheet(tmp_path: Path) -> None:
    assert velocimetry.light_sheet(data_of(tmp_path, {}, "velocimetry")) is None


def test_only_components_in_the_sheet_count(tmp_path: Path) -> None:
    """Planar estimates and those of volumes are scored alike."""
    flow = {"generator": "linear_flow", "velocity_mm_s": [40.0, -30.0, 20.0]}
    data = data_of(tmp_path, {"flow": flow})
    nodes = velocimetry.TASK.truth(data, 0)
    assert nodes.plane_axes is not None
    expected = np.broadcast_to([40.0, -30.0, 0.0], (*nodes.valid.shape, 3))
    np.testing.assert_allclose(nodes.velocity_mm_s, expected)
    everywhere, valid = np.tile([40.0, -30.0, 500.0], (5, 17, 17, 1)), np.ones((5, 17, 17), bool)
    solid = Velocity((-8.0, -8.0, -2.0), (1.0, 1.0, 1.0), everywhere, valid)
    scores = velocimetry.score_pair(data, (0, 1), solid)
    assert scores["yield_percent"] == 100.0
    assert scores["rms_voxel"] == pytest.approx(0.0, abs=1e-9)
    solid.velocity_mm_s[:] = [40.0, 30.0, 20.0]
    assert velocimetry.score_pair(data, (0, 1), solid)["v_p90_voxel"] == pytest.approx(0.06 / 0.05)


@pytest.mark.slow
def test_the_truth_of_a_planar_field_is_the_mean_over_the_sheet(tmp_path: Path) -> None:
    """A shear across the sheet cancels, a curvature does not: du/dz^2 by a vortex about X."""
    data = data_of(tmp_path, {"flow.axis": [1.0, 0.0, 0.0], "illumination.thickness_mm": 1.0})
    nodes = velocimetry.TASK.empty(data, 0)
    thin = sheet_of(data)
    points = nodes.positions_mm.reshape(-1, 3)
    layers = [
        velocimetry.true_velocity(data, (0, 1), points + z * thin.normal)
        for z in np.linspace(-0.5, 0.5, 101)
    ]
    weights = np.r_[0.5, np.ones(99), 0.5]
    mean = np.average(layers, axis=0, weights=weights).reshape(nodes.velocity_mm_s.shape)
    exact = velocimetry.truth_at(data, (0, 1), nodes)
    assert np.abs(exact - mean * [1.0, 1.0, 0.0]).max() < 1e-2 * np.abs(mean).max()


@pytest.mark.slow
def test_a_tilted_sheet_from_the_command_s_parameters_to_scores(tmp_path: Path) -> None:
    normal = [0.0, 0.6, 0.8]
    changes = {
        "illumination.sheet_normal": normal,
        "volume.size_mm": [10.0, 8.0, 7.0],
        "grid.voxel_mm": [0.05, 0.05, 0.05],
        "flow.axis": normal,
        "particles.per_mm3": 20.0,
    }
    data = data_of(tmp_path, changes)
    out = tmp_path / "result.h5"
    solve("piv2d", data, out, parameters={"normal": normal})
    scores = score(data, out)
    assert scores["yield_percent"] > 80.0
    assert scores["rms_voxel"] < 0.3
    assert scores["response"] == pytest.approx(1.0, abs=0.05)
    assert scores["vorticity_percent"] < 30.0
    assert scores["divergence_1_s"] is None
    assert scores["reconstruction_s"] is None
    assert velocimetry.TASK.picture(data, open_result(out, data)).startswith(b"\x89PNG")
    np.testing.assert_allclose(open_result(out, data).read(Velocity, 0).axes[2], normal, atol=1e-9)
    solve("piv2d", data, out, parameters={"normal": [0.0, 0.0, 1.0]}, overwrite=True)
    wrong = score(data, out)  # it crosses the light in a line
    assert wrong["yield_percent"] < 20.0
    assert not velocimetry.TASK.admits(wrong)


def test_a_planar_field_of_a_lit_volume_measures_little(tmp_path: Path) -> None:
    """It does not rank among fields of the volume."""
    data = data_of(tmp_path, {}, "velocimetry")
    nodes = velocimetry.TASK.truth(data, 0)
    middle = len(nodes.valid) // 2
    x, y, z = nodes.low_mm
    low, flow = (x, y, z + middle * nodes.step_mm[2]), nodes.velocity_mm_s[[middle]] * [1, 1, 0]
    plane = Velocity(low, nodes.step_mm, flow, nodes.valid[[middle]], np.eye(3)[:2])
    with result_writer(tmp_path / "plane.h5", data, "nobody", "velocimetry", {}) as writer:
        writer.add(plane, 0)
    scores = score(data, tmp_path / "plane.h5")
    assert scores["yield_percent"] < 15.0
    assert not velocimetry.TASK.admits(scores)
