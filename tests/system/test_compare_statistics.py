"""The command compare-statistics on a data set and the same images as a stranger's folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import sabench
from sabench.apps.recordings import measure_dataset
from sabench.dataset.copies import pack
from sabench.dataset.reader import Dataset
from sabench.evaluation.suite_loading import override
from sabench.scenes import load_scene
from tests.conftest import Command

MORE = {
    "particles.per_pixel": 0.004,
    "particles.velocity_mm_s": [300.0, 0.0, 0.0],
    "sensor.read_noise_e": 20.0,
    "sensor.dsnu_e": 40.0,
    "sensor.black_level_dn": 64.0,
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = load_scene("quick")
    table = scene.to_dict()["particles"]
    table.pop("count", None)
    values = {"particles": table | {"per_pixel": 0.004}} | MORE
    moving = override(scene.with_frames(4), values, "quick, moving")
    out = tmp_path_factory.mktemp("data") / "quick"
    return sabench.generate(moving, out, seed=1, backend="splat")


@pytest.fixture(scope="module")
def folder(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The images of the data set, a folder for each camera, without its black and white level."""
    out = tmp_path_factory.mktemp("images")
    for number, camera in enumerate(data.setup.cameras):
        (out / camera.name).mkdir()
        for frame in range(4):
            cv2.imwrite(str(out / camera.name / f"{frame}.png"), data.raw_image(number, frame))
    return out


def figures(command: Command, *arguments: object) -> dict[str, Any]:
    done = command("compare-statistics", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def test_the_same_images_have_the_same_figures(
    data: Dataset, folder: Path, command: Command
) -> None:
    white = data.setup.sensor.white_dn
    both = figures(command, data.root, folder, "--white", white)
    own, other = both["dataset"], both["recording"]
    assert own["cameras"] == other["cameras"]
    assert own["ratio_matched_by"] == "true positions"
    assert own["ratio_pairs"] > 100
    assert other["ratio_matched_by"] is None
    assert "ln_ratio" not in other["median"]


def test_figures_are_those_of_the_scene(data: Dataset) -> None:
    found = measure_dataset(data, 4).medians()
    sensor, scale = data.scene.sensor, 255.0 / data.setup.sensor.white_dn
    noise = scale * np.hypot(sensor.gain_dn_e * 20.0, 12**-0.5)
    assert found["temporal"] == pytest.approx(noise, rel=0.15)
    assert found["fixed_near"] == pytest.approx(scale * sensor.gain_dn_e * 40.0, rel=0.15)
    lowest = scale * (64.0 - 1.5 * sensor.gain_dn_e * np.hypot(20.0, 40.0))
    assert lowest < (found["background_p50"] or 0.0) < scale * 64.0  # the least of 9 x 9 pixels
    visible = np.concatenate([view.sigma_px[view.visible] for view in data.views(0)])
    assert found["width_p50"] == pytest.approx(np.median(visible), rel=0.1)


def test_the_ratio_of_fluxes_is_that_of_the_truth(data: Dataset) -> None:
    found = measure_dataset(data, 4).medians()
    photons = np.stack([np.where(view.visible, view.photons, np.nan) for view in data.views(0)])
    logs = np.log(photons)
    ratios = [logs[i] - logs[j] for i in range(len(logs)) for j in range(i)]
    true = np.concatenate([one - np.nanmedian(one) for one in ratios])
    robust = 1.4826 * np.nanmedian(np.abs(true))
    assert found["ln_ratio_robust"] == pytest.approx(robust, rel=0.2)


def test_without_truth_particles_are_triangulated(
    data: Dataset, tmp_path: Path, command: Command
) -> None:
    pack(data, tmp_path / "blind", blind=True)
    both = figures(command, data.root, tmp_path / "blind")
    assert both["recording"]["ratio_matched_by"] == "triangulated positions"
    assert both["recording"]["median"]["ln_ratio_robust"] == pytest.approx(
        both["dataset"]["median"]["ln_ratio_robust"], rel=0.15
    )
