"""The command preprocess on data sets, recorded ones, and image files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import sabench
from sabench.dataset.reader import Dataset
from sabench.scenes import load_scene, parse_scene
from tests.conftest import Command

STEPS = ("--step", "sliding_minimum,window_px=9", "--step", "gaussian,sigma_px=0.6")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    values = load_scene("quick").to_dict()
    values["particles"]["velocity_mm_s"] = [300.0, 0.0, 0.0]
    scene = parse_scene(values, "moving").with_frames(3)
    out = tmp_path_factory.mktemp("data") / "moving"
    return sabench.generate(scene, out, seed=1, backend="splat")


def stages(command: Command, *arguments: object) -> list[dict[str, Any]]:
    done = command("preprocess", *map(str, arguments), "--json")
    assert done.returncode == 0, done.stderr
    out: list[dict[str, Any]] = json.loads(done.stdout)
    return out


def test_every_step_is_shown_with_its_peaks(
    command: Command, data: Dataset, tmp_path: Path
) -> None:
    picture = tmp_path / "preview.png"
    done = command("preprocess", str(data.root), *STEPS, "-o", str(picture))
    assert done.returncode == 0, done.stderr
    for word in ("recorded", "repaired", "sliding_minimum", "gaussian", "1e-05 per pixel"):
        assert word in done.stdout
    image = cv2.imread(str(picture))
    assert image is not None
    assert image.shape[1] > 1.5 * image.shape[0]
    again = command("preprocess", str(data.root), "-o", str(picture))
    assert again.returncode == 2
    assert "exists already" in again.stderr


def test_peaks_are_those_of_the_particles(command: Command, data: Dataset) -> None:
    name = data.setup.cameras[1].name
    by_name = stages(command, data.root, "--camera", name, "--frame", 1)
    assert by_name == stages(command, data.root, "--camera", 1, "--frame", 1)
    visible = int(data.views(1)[1].visible.sum())
    assert by_name[0]["black"] == pytest.approx(data.setup.sensor.black_dn, abs=1.5)
    assert 0.5 * visible < by_name[0]["peaks"] <= visible + 2


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", ["png", "tif", "bmp"])
def test_a_plain_image_is_taken(
    command: Command, data: Dataset, tmp_path: Path, suffix: str, bits: int
) -> None:
    if suffix == "bmp" and bits == 16:
        pytest.skip("a BMP has 8 bits")
    path = tmp_path / f"Bild 1.{suffix}"
    image = data.raw_image(0, 0)
    shown = image if bits == 16 else np.minimum(image // 16, 255).astype(np.uint8)
    assert cv2.imwrite(str(path), shown)
    seen = stages(command, path, *STEPS)
    assert [one["step"] for one in seen] == ["recorded", "repaired", "sliding_minimum", "gaussian"]
    assert seen[0]["peaks"] > 10


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--camera", "nine"], "--camera: expected one of"),
        (["--frame", "7"], "frame 7: expected 0 to 2"),
        (["--step", "median"], "--step"),
        (["--step", "gaussian", "--step", "temporal_minimum"], "as the first step"),
    ],
)
def test_wrong_options_are_named(
    command: Command, data: Dataset, arguments: list[str], sentence: str
) -> None:
    done = command("preprocess", str(data.root), *arguments)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_what_is_no_image_is_refused(command: Command, tmp_path: Path) -> None:
    text, movie, grey = tmp_path / "a.png", tmp_path / "a.avi", tmp_path / "b.png"
    text.write_text("no image")
    movie.write_bytes(b"RIFF")
    cv2.imwrite(str(grey), np.zeros((20, 20), dtype=np.uint8))
    for arguments, sentence in (
        ([text], "expected an image"),
        ([movie], "make a data set of it"),
        ([tmp_path / "none.png"], "got none"),
        ([tmp_path], "expected a data set"),
        ([grey, "--camera", "0"], "--camera: expected a data set"),
        ([grey, "--step", "match_histograms"], "several cameras"),
        ([grey, "--step", "temporal_minimum"], "two frames or more"),
        ([grey, "--frame", "3"], "image 3"),
    ):
        done = command("preprocess", *map(str, arguments))
        assert done.returncode == 2, sentence
        assert sentence in done.stderr
        assert "Traceback" not in done.stderr
    assert command("preprocess", str(grey)).returncode == 0
