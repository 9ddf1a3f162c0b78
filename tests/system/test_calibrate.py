"""The command `sabench calibrate`.

A user's folder with points or images becomes cameras and a report, or an error of one sentence.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w
from pydantic import TypeAdapter

from sabench.geometry.camera import Camera
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.scenes.illumination import Lighting
from sabench.simulation.rendering.targets_traced import render
from sabench.utils.arrays import F64
from sabench.worlds.calibration_targets import place
from tests.conftest import Command
from tests.helpers.calibration_cases import calibration_scene, case_of, true_error_px


def describe(scene: Scene, folder: Path, cameras: tuple[Camera, ...], **changes: Any) -> None:
    """calibration.toml as an experimenter with a ruler would write it."""
    target = dict(scene.targets or {})
    spec = scene.cameras
    values: dict[str, Any] = {
        "target_mm": [0.0, 0.0, 35.0],
        "target": {key: target[key] for key in ("pattern", "columns", "rows", "pitch_mm")},
        "array": {
            "rows": spec.rows,
            "columns": spec.columns,
            "pixel_mm": spec.pixel_mm,
            "focal_length_mm": 85.0,
            "principal_distance_mm": 100.0,
        },
        "wall": {"fluid_index": 1.333, "layers": [{"index": 1.5, "thickness_mm": 5.0}]},
        "cameras": [
            {
                "name": c.name,
                "center_mm": [round(v / 10.0) * 10.0 for v in c.center_mm],
                "aim_mm": [2.0, -2.0, 30.0],
            }
            for c in cameras
        ],
    } | changes
    folder.mkdir(exist_ok=True)
    (folder / "calibration.toml").write_text(tomli_w.dumps(values))


def write_points(path: Path, pixels: F64, cameras: tuple[Camera, ...]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["camera", "frame", "point", "column", "row"])
        for c, k, i in np.argwhere(np.isfinite(pixels[..., 0])).tolist():
            writer.writerow([cameras[c].name, k, i, *pixels[c, k, i]])


def cameras_in(path: Path) -> tuple[Camera, ...]:
    content = json.loads(path.read_text())
    assert (content["format"], content["version"]) == ("sabench-dataset", 1)
    records = [{**record, "wall": content["wall"]} for record in content["cameras"]]
    return tuple(TypeAdapter(Camera).validate_python(record) for record in records)


@pytest.mark.slow
def test_a_round_tank_is_calibrated(command: Command, tmp_path: Path) -> None:
    """Three cameras in front of a cylinder, which the report and cameras.json keep."""
    wall = {
        "shape": "cylinder",
        "axis_point_mm": [0.0, 0.0, 90.0],
        "outer_radius_mm": 90.0,
        "fluid_index": 1.333,
        "layers": [{"index": 1.5, "thickness_mm": 5.0}],
    }
    layout = {"kind": "line", "count": 3, "spacing_mm": 150.0}
    target = {"generator": "boards", "pattern": "checkerboard", "pitch_mm": 9.0}
    scene = calibration_scene(
        targets={**target, "columns": 5, "rows": 5}, cameras={"layout": layout}, calibration=None
    )
    values = scene.to_dict() | {"wall": wall}
    case, cameras, _, _ = case_of(parse_scene(values, "round"))
    known = [{"frame": 2, "point": 12, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 35.0}]
    describe(scene, tmp_path / "mine", cameras, wall=wall, known=known)
    write_points(tmp_path / "mine" / "points.csv", case.pixels, cameras)
    run = command("calibrate", str(tmp_path / "mine"))
    assert run.returncode == 0, run.stderr
    content = json.loads((tmp_path / "mine" / "result" / "cameras.json").read_text())
    assert content["wall"]["outer_radius_mm"] == 90.0
    report = json.loads((tmp_path / "mine" / "result" / "report.json").read_text())
    assert report["noise_px"] == pytest.approx(0.1, rel=0.1)


def test_points_become_cameras(command: Command, tmp_path: Path) -> None:
    scene = calibration_scene(detection={"noise_px": 0.2, "missing": 0.05, "outliers": 0.02})
    case, cameras, points, exact = case_of(scene)
    known = [
        {
            "frame": 2,
            "point": 60,
            "x_mm": points[2, 60, 0],
            "y_mm": points[2, 60, 1],
            "z_mm": points[2, 60, 2],
        }
    ]
    describe(scene, tmp_path / "mine", cameras, known=known)
    write_points(tmp_path / "mine" / "points.csv", case.pixels, cameras)
    done = command("calibrate", "mine", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["noise_px"] == pytest.approx(0.2, rel=0.05)
    assert report["depth_mm"] < 0.1
    assert len(report["cameras"]) == 9
    assert (
        0.9
        < sum(line["used"] for line in report["frames"])
        / sum(line["found"] for line in report["frames"])
        < 1.0
    )
    made = cameras_in(tmp_path / "mine" / "result" / "cameras.json")
    depth = np.mean(
        [own.center_mm[2] - true.center_mm[2] for own, true in zip(made, cameras, strict=True)]
    )
    assert abs(depth) < 0.5
    assert (
        true_error_px(made, points, exact) < 40.0
    )  # turned about the normal, which one known point leaves open
    assert (tmp_path / "mine/result/errors.png").read_bytes().startswith(b"\x89PNG")
    assert command("calibrate", "mine").returncode == 2  # the result is there
    again = command("calibrate", "mine", "--overwrite")
    assert again.returncode == 0, again.stderr
    assert "expected true error" in again.stdout


@pytest.mark.slow
def test_images_become_cameras(command: Command, tmp_path: Path) -> None:
    layout = {
        "kind": "list",
        "places": [
            {"center_mm": [x, y, -490.0]}
            for x, y in ((-150.0, -80.0), (150.0, -80.0), (0.0, 150.0))
        ],
    }
    scene = calibration_scene(
        cameras={"rows": 600, "columns": 600, "pixel_mm": 0.02, "layout": layout},
        targets={"pitch_mm": 3.2},
    )
    lamps = Lighting.model_validate(
        {"lamps": [{"center_mm": [-300.0, -100.0, -400.0]}, {"center_mm": [300.0, 100.0, -400.0]}]}
    )
    cameras, placed = build_rig(scene).cameras, place(scene, 1)
    describe(scene, tmp_path / "mine", cameras)
    for frame, pose in enumerate(placed.poses):
        folder = tmp_path / "mine" / "images" / f"frame_{frame}"
        folder.mkdir(parents=True)
        for camera in cameras:
            picture = render(camera, placed.target, pose, lamps, np.array([0.0, 0.0, 35.0]), 9)
            assert cv2.imwrite(
                str(folder / f"{camera.name}.png"),
                np.clip(200.0 * picture, 0.0, 255.0).astype(np.uint8),
            )
    done = command("calibrate", "mine", "-o", "out", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["noise_px"] < 0.05
    assert all(
        line["found"] >= 484 and line["used"] > 0.9 * line["found"] for line in report["cameras"]
    ), report
    focal = [
        camera.principal_distance_mm for camera in cameras_in(tmp_path / "out" / "cameras.json")
    ]
    np.testing.assert_allclose(
        focal, [camera.principal_distance_mm for camera in cameras], rtol=0.02
    )


def faulty(folder: Path, what: str) -> None:
    scene = calibration_scene()
    case, cameras, *_ = case_of(scene)
    describe(scene, folder, cameras)
    lines = ["camera,frame,point,column,row", "camera_00,0,0,1.5,2.5"]
    text = (folder / "calibration.toml").read_text()
    if what == "configuration":
        (folder / "calibration.toml").unlink()
    elif what == "key":
        (folder / "calibration.toml").write_text(text.replace("pitch_mm", "pich_mm"))
    elif what == "wall":
        (folder / "calibration.toml").write_text(
            text.replace("[wall]", "[wall]\npoint_mm = [0.0, 0.0, -900.0]")
        )
    elif what == "header":
        lines[0] = "camera,frame,point,x,y"
    elif what == "number":
        lines.append("camera_00,0,one,1,1")
    elif what == "camera":
        lines.append("camera_77,0,1,1,1")
    elif what == "twice":
        lines.append(lines[1])
    if what != "images":
        (folder / "points.csv").write_text("\n".join(lines) + "\n")
    assert case.found.all()


FAULTS = {
    "configuration": "calibration.toml: expected the description of a calibration, found none",
    "key": "calibration.toml: target.pich_mm: unknown key; did you mean pitch_mm?",
    "wall": "calibration.toml: camera camera_00: no light path to its aim point",
    "header": "points.csv: expected the first line camera,frame,point,column,row and possibly x_mm",
    "number": "points.csv: line 3: point: expected a whole number, got one",
    "camera": "points.csv: line 3: expected one of the cameras",
    "twice": "points.csv: line 3: camera_00, frame 0: expected point 0 once, got it twice",
    "images": (
        "images: expected folders with an image of each camera, or a points.csv next to it, "
        "found neither"
    ),
    "few": "camera_01: expected it to see some of the target, but not one of its points was found",
}


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_is_one_sentence(command: Command, tmp_path: Path, what: str) -> None:
    faulty(tmp_path / "mine", what)
    done = command("calibrate", "mine")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert FAULTS[what] in " ".join(done.stderr.split()), done.stderr
    assert not (tmp_path / "mine" / "result").exists()
