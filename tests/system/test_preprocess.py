"""The commands preprocess and compare-statistics."""

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
from sabench.scenes import load_scene, parse_scene
from tests.conftest import Command
from tests.helpers.commands import refuse, succeed

STEPS = ("--step", "sliding_minimum,window_px=9", "--step", "gaussian,sigma_px=0.6")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    values = load_scene("quick").to_dict()
    values["particles"]["velocity_mm_s"] = [300.0, 0.0, 0.0]
    scene = parse_scene(values, "moving").with_frames(3)
    out = tmp_path_factory.mktemp("data") / "moving"
    return sabench.generate(scene, out, seed=1, backend="splat")


def stages(command: Command, *arguments: object) -> list[dict[str, Any]]:
    done = succeed(command("preprocess", *map(str, arguments), "--json"))
    out: list[dict[str, Any]] = json.loads(done.stdout)
    return out


@pytest.mark.slow
def test_steps_are_shown_with_their_peaks(command: Command, data: Dataset, tmp_path: Path) -> None:
    picture = tmp_path / "preview.png"
    done = succeed(command("preprocess", str(data.root), *STEPS, "-o", str(picture)))
    for word in ("recorded", "repaired", "sliding_minimum", "gaussian", "1e-05 per pixel"):
        assert word in done.stdout
    image = cv2.imread(str(picture))
    assert image is not None
    assert image.shape[1] > 1.5 * image.shape[0]
    refuse(command("preprocess", str(data.root), "-o", str(picture)), "preview.png")


@pytest.mark.slow
def test_peaks_are_those_of_the_particles(command: Command, data: Dataset) -> None:
    by_name = stages(command, data.root, "--camera", data.setup.cameras[1].name, "--frame", 1)
    assert by_name == stages(command, data.root, "--camera", 1, "--frame", 1)
    visible = int(data.views(1)[1].visible.sum())
    assert by_name[0]["black"] == pytest.approx(data.setup.sensor.black_dn, abs=1.5)
    assert 0.5 * visible < by_name[0]["peaks"] <= visible + 2


@pytest.mark.slow_but_first
@pytest.mark.parametrize(("suffix", "bits"), [("png", 8), ("tif", 16), ("bmp", 8)])
def test_a_plain_image(
    command: Command, data: Dataset, tmp_path: Path, suffix: str, bits: int
) -> None:
    path = tmp_path / f"Bild 1.{suffix}"
    image = data.raw_image(0, 0)
    shown = image if bits == 16 else np.minimum(image // 16, 255).astype(np.uint8)
    assert cv2.imwrite(str(path), shown)
    seen = stages(command, path, *STEPS)
    assert [one["step"] for one in seen] == ["recorded", "repaired", "sliding_minimum", "gaussian"]
    assert seen[0]["peaks"] > 10


@pytest.mark.slow
def test_what_is_no_image_is_refused(command: Command, data: Dataset, tmp_path: Path) -> None:
    text, movie, grey = tmp_path / "a.png", tmp_path / "a.avi", tmp_path / "b.png"
    text.write_text("no image")
    movie.write_bytes(b"RIFF")
    cv2.imwrite(str(grey), np.zeros((20, 20), dtype=np.uint8))
    for path, options, key in (
        (data.root, "--camera nine", "--camera"),
        (data.root, "--frame 7", "frame 7"),
        (data.root, "--step median", "--step"),
        (data.root, "--step gaussian --step temporal_minimum", "temporal_minimum"),
        (text, "", "a.png"),
        (movie, "", "a.avi"),
        (tmp_path / "none.png", "", "none.png"),
        (tmp_path, "", ""),
        (grey, "--camera 0", "--camera"),
        (grey, "--step match_histograms", "match_histograms"),
        (grey, "--step temporal_minimum", "temporal_minimum"),
        (grey, "--frame 3", "3"),
    ):
        refuse(command("preprocess", path, *options.split()), key)
    assert command("preprocess", str(grey)).returncode == 0


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = load_scene("quick")
    table = scene.to_dict()["particles"]
    table.pop("count", None)
    table |= {"per_pixel": 0.004, "velocity_mm_s": [300.0, 0.0, 0.0]}
    noise = {"read_noise_e": 20.0, "dsnu_e": 40.0, "black_level_dn": 64.0}
    values = {"particles": table} | {f"sensor.{key}": value for key, value in noise.items()}
    moving = override(scene.with_frames(4), values, "quick, moving")
    out = tmp_path_factory.mktemp("data") / "quick"
    return sabench.generate(moving, out, seed=1, backend="splat")


@pytest.fixture(scope="module")
def folder(busy: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("images")
    for number, camera in enumerate(busy.setup.cameras):
        (out / camera.name).mkdir()
        for frame in range(4):
            cv2.imwrite(str(out / camera.name / f"{frame}.png"), busy.raw_image(number, frame))
    return out


def figures(command: Command, *arguments: object) -> dict[str, Any]:
    return dict(json.loads(succeed(command("compare-statistics", *arguments, "--json")).stdout))


@pytest.mark.slow
def test_equal_images_have_equal_figures(busy: Dataset, folder: Path, command: Command) -> None:
    both = figures(command, busy.root, folder, "--white", busy.setup.sensor.white_dn)
    own, other = both["dataset"], both["recording"]
    assert own["cameras"] == other["cameras"]
    assert own["ratio_matched_by"] == "true positions"
    assert own["ratio_pairs"] > 100
    assert other["ratio_matched_by"] is None
    assert "ln_ratio" not in other["median"]


def test_figures_are_those_of_the_scene(busy: Dataset) -> None:
    found = measure_dataset(busy, 4).medians()
    sensor, scale = (busy.scene.sensor, 255.0 / busy.setup.sensor.white_dn)
    noise = scale * np.hypot(sensor.gain_dn_e * 20.0, 12**-0.5)
    assert found["temporal"] == pytest.approx(noise, rel=0.15)
    assert found["fixed_near"] == pytest.approx(scale * sensor.gain_dn_e * 40.0, rel=0.15)
    lowest = scale * (64.0 - 1.5 * sensor.gain_dn_e * np.hypot(20.0, 40.0))
    assert lowest < (found["background_p50"] or 0.0) < scale * 64.0  # the least of 9 x 9 pixels
    visible = np.concatenate([view.sigma_px[view.visible] for view in busy.views(0)])
    assert found["width_p50"] == pytest.approx(np.median(visible), rel=0.1)


def test_the_ratio_of_fluxes_is_that_of_the_truth(busy: Dataset) -> None:
    found = measure_dataset(busy, 4).medians()
    photons = np.stack([np.where(view.visible, view.photons, np.nan) for view in busy.views(0)])
    logs = np.log(photons)
    ratios = [logs[i] - logs[j] for i in range(len(logs)) for j in range(i)]
    true = np.concatenate([one - np.nanmedian(one) for one in ratios])
    assert found["ln_ratio_robust"] == pytest.approx(1.4826 * np.nanmedian(np.abs(true)), rel=0.2)


@pytest.mark.slow
def test_without_truth_they_are_found(busy: Dataset, tmp_path: Path, command: Command) -> None:
    pack(busy, tmp_path / "blind", blind=True)
    both = figures(command, busy.root, tmp_path / "blind")
    assert both["recording"]["ratio_matched_by"] == "triangulated positions"
    assert both["recording"]["median"]["ln_ratio_robust"] == pytest.approx(
        both["dataset"]["median"]["ln_ratio_robust"], rel=0.15
    )
