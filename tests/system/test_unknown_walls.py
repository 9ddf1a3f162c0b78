"""Scenes and folders whose wall nobody has measured."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.dataset.cameras import write_cameras
from sabench.geometry.refraction import Wall
from sabench.utils.errors import InputError
from tests.conftest import Command
from tests.helpers.calibration_cases import calibration_scene
from tests.helpers.calibration_tanks import make_tank, with_places
from tests.system.test_calibrate_tanks import write

ERRORS = {
    "wall_mm": 3.0,
    "wall_deg": 0.5,
    "thickness_percent": 5.0,
    "layer_index": 0.01,
    "fluid_index": 0.003,
    "unknown": ["wall", "thickness", "layer_index", "fluid_index"],
}
KNOWN = [{"frame": frame, "point": point} for frame in range(5) for point in (0, 10, 60, 110, 120)]
EXACT: dict[str, Any] = {"center_mm": 0.0, "turn_deg": 0.0, "focal_percent": 0.0}


def test_a_data_set_holds_the_nominal_wall_and_the_true_one(tmp_path: Path) -> None:
    known = EXACT | {"known_cameras": True, "known": KNOWN, "unknown": ["wall"]}
    errors = {"wall_mm": 3.0, "wall_deg": 0.5}
    scene = calibration_scene(calibration=known | errors)
    data = sabench.generate(scene, tmp_path / "boards", seed=1, backend="splat")
    case = data.calibration_case()
    nominal, true = case.cameras[0].wall, data.true_cameras[0].wall
    assert isinstance(nominal, Wall)
    assert isinstance(true, Wall)
    assert case.known_cameras
    assert nominal != true
    assert replace(case.cameras[0], wall=true) == data.true_cameras[0]
    before = sabench.score(data, "empty")
    result = sabench.solve("refractive_autocal", data, tmp_path / "r.h5")
    after = sabench.score(data, result.path)
    for name in ("wall_place_error_mm", "wall_tilt_error_deg"):
        assert 0.0 < after[name] < 0.05 * before[name]
    assert after["true_ratio"] == pytest.approx(1.0, abs=0.3)


def test_solvers_of_lenses_decline_an_unknown_wall(tmp_path: Path) -> None:
    scene = calibration_scene(calibration=ERRORS | {"known": KNOWN})
    data = sabench.generate(scene, tmp_path / "boards", seed=1, backend="splat")
    assert sabench.score(data, "truth")["bound_px"] > 0.0
    with pytest.raises(InputError, match="use refractive_autocal"):
        sabench.solve("refractive_autocal_alternating", data, tmp_path / "r.h5")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"calibration": {"known_cameras": True}}, "known_cameras: expected cameras without"),
        (
            {"calibration": EXACT | {"known_cameras": True, "unknown": ["k1"]}},
            "known_cameras: expected unknowns of the wall",
        ),
        ({"calibration": {"wall_mm": 1.0}, "wall": None}, "expected one plane wall"),
        ({"calibration": {"thickness_percent": 50.0}}, "thickness_percent"),
    ],
)
def test_impossible_errors_are_a_sentence(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        calibration_scene(**changes)


@pytest.mark.slow
def test_a_folder_with_known_cameras_finds_its_wall(command: Command, tmp_path: Path) -> None:
    case, cameras, places = make_tank()
    folder = tmp_path / "mine"
    changes: dict[str, Any] = {
        "array": None,
        "cameras": None,
        "known_cameras": "air.json",
        "target_mm": [0.0, 0.0, 70.0],
        "unknown": ["wall"],
    }
    wall = {"point_mm": [0.0, 0.0, -4.0], "fluid_index": 1.333}
    wall |= {"layers": [{"index": 1.5, "thickness_mm": 8.0}]}
    write(folder, with_places(case, places), np.eye(3), **changes, wall=wall)
    write_cameras(folder / "air.json", cameras)
    done = command("calibrate", "mine")
    assert done.returncode == 0, done.stderr
    assert "tilt of the wall about X" in done.stdout
    report = json.loads((folder / "result/report.json").read_text())
    place = report["wall"][-1]
    assert place["name"] == "place of the wall"
    assert place["found"] == pytest.approx(4.0, abs=4.0 * place["std"])
    made = json.loads((folder / "result/cameras.json").read_text())["cameras"]
    for entry, camera in zip(made, cameras, strict=True):
        np.testing.assert_allclose(entry["center_mm"], camera.center_mm, atol=1e-9)
    done = command("calibrate", "mine", "-o", "again", "--unknowns", "wall,thickness,layer_index")
    assert done.returncode == 0, done.stderr
    first = " ".join(done.stdout.split())
    assert "The data hardly show the index of" in first
    assert "(standard deviation" in first


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"known_cameras": "air.json"}, "expected either known_cameras or array and cameras"),
        ({"array": None}, "expected tables array and cameras, or known_cameras"),
        ({"array": None, "cameras": None, "known_cameras": "air.json"}, "target_mm: expected it"),
        (
            {
                "array": None,
                "cameras": None,
                "known_cameras": "no.json",
                "target_mm": [0.0, 0.0, 70.0],
            },
            "no.json",
        ),
    ],
)
def test_faulty_known_cameras_are_a_sentence(
    command: Command, tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    case, _, _ = make_tank()
    write(tmp_path / "mine", case, np.eye(3), **changes)
    done = command("calibrate", "mine")
    assert done.returncode != 0
    assert words in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
