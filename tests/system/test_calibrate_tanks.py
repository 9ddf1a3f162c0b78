"""`sabench calibrate` on tanks of any axes, with known places, and with every solver."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from sabench.api import CalibrationCase
from sabench.geometry.refraction import Wall
from sabench.utils.arrays import F64
from tests.conftest import Command
from tests.helpers.calibration_tanks import (
    MIDDLE,
    make_tank,
    off_wall,
    rotated,
    with_places,
)

Y_UP = np.diag([1.0, -1.0, -1.0])  # Y up, Z towards the cameras
HEAD = ["camera", "frame", "point", "column", "row"]
BOARD = {"pattern": "checkerboard", "columns": 6, "rows": 5, "pitch_mm": 10.0}


def write(folder: Path, case: CalibrationCase, rotation: F64, **changes: Any) -> None:
    """Write a case as an experimenter with a ruler would."""
    wall = case.cameras[0].wall
    assert isinstance(wall, Wall)
    values: dict[str, Any] = {
        "target": BOARD,
        "array": {
            "rows": 800,
            "columns": 900,
            "pixel_mm": 0.01,
            "focal_length_mm": 50.0,
        },
        "wall": {
            "point_mm": list(wall.point_mm),
            "normal": list(wall.normal),
            "fluid_index": 1.333,
            "layers": [{"index": 1.5, "thickness_mm": 8.0}],
        },
        "cameras": [
            {
                "name": camera.name,
                "center_mm": [round(value) for value in camera.center_mm],
                "aim_mm": (rotation @ MIDDLE).tolist(),
            }
            for camera in case.cameras
        ],
    } | changes
    folder.mkdir()
    kept = {key: value for key, value in values.items() if value is not None}
    (folder / "calibration.toml").write_text(tomli_w.dumps(kept))
    with (folder / "points.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*HEAD, "x_mm", "y_mm", "z_mm", "sigma_mm"])
        for c, k, i in np.argwhere(np.isfinite(case.pixels[..., 0])).tolist():
            known = case.known_mm[k, i]
            place = [*known, case.known_sigma_mm[k, i, 0]] if np.isfinite(known).all() else [""] * 4
            writer.writerow([case.cameras[c].name, k, i, *case.pixels[c, k, i], *place])


def test_the_first_line_says_that_boards_show_no_depth(command: Command, tmp_path: Path) -> None:
    case, _, _ = make_tank()
    write(tmp_path / "mine", case, np.eye(3))
    done = command("calibrate", "mine")
    assert done.returncode == 0, done.stderr
    first = done.stdout.splitlines()[0]
    assert first.startswith("The boards do not show how far they are from the wall")
    assert "Measure the distance of one point" in " ".join(done.stdout.split())
    report = json.loads((tmp_path / "mine/result/report.json").read_text())
    assert report["held_out"]["frames"] == 6
    assert report["held_out"]["reprojection_px"] == pytest.approx(0.05, rel=0.3)


@pytest.mark.slow
def test_a_world_with_y_up_and_its_places_enter_as_they_are(
    command: Command, tmp_path: Path
) -> None:
    """The nominal wall is 40 mm off; held-out boards choose its place and k1."""
    case, _, places = make_tank(k1=-0.5)
    case = rotated(off_wall(with_places(case, places), -40.0), Y_UP)
    write(tmp_path / "mine", case, Y_UP, up=[0.0, 1.0, 0.0])
    done = command("calibrate", "mine", "--unknowns", "auto")
    assert done.returncode == 0, done.stderr
    assert "recommended and used: unknown = [" in done.stdout
    report = json.loads((tmp_path / "mine/result/report.json").read_text())
    assert {"wall", "k1"} <= set(report["unknown"])
    assert report["held_out"]["known_mm"] < 0.05
    wall = json.loads((tmp_path / "mine/result/cameras.json").read_text())["wall"]
    assert abs(wall["point_mm"][2]) < 3.0
    with (tmp_path / "mine/result/target.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows])
    assert len(rows) == 180
    np.testing.assert_allclose(found, (places @ Y_UP.T).reshape(-1, 3), atol=0.1)
    assert (tmp_path / "mine/result/residuals/camera_02.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_misfit_shows_in_the_expected_error(command: Command, tmp_path: Path) -> None:
    case, _, places = make_tank()
    case = off_wall(with_places(case, places), -40.0)
    write(tmp_path / "mine", case, np.eye(3))
    report = json.loads(command("calibrate", "mine", "--json").stdout)
    assert "no noise" in report["summary"][0]
    assert np.linalg.norm(report["std_mm"]) > 10.0 * np.linalg.norm(report["noise_std_mm"])


@pytest.mark.slow
@pytest.mark.parametrize("target", [None, BOARD])
@pytest.mark.parametrize("solver", ["refractive_resection", "soloff", "pinhole_linear"])
def test_solvers_of_known_places_are_reachable(
    command: Command, tmp_path: Path, solver: str, target: Any
) -> None:
    case, _, places = make_tank()
    write(tmp_path / "mine", with_places(case, places), np.eye(3), target=target)
    done = command("calibrate", "mine", "--solver", solver, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    limit = 0.3 if solver == "pinhole_linear" else 0.15  # straight lines through a flat glass
    assert report["noise_px"] < limit
    assert report["held_out"]["known_mm"] < 2.0 * limit
    cameras = json.loads((tmp_path / "mine/result/cameras.json").read_text())["cameras"]
    assert len(cameras) == 3


@pytest.mark.slow
def test_a_target_of_any_shape_moves(command: Command, tmp_path: Path) -> None:
    """Every second row of dots lies deeper: a rigid target that is not flat."""
    case, cameras, places = make_tank()
    board = case.target.points_mm.copy()
    board[:, 2] = 6.0 * (np.arange(30) // 6 % 2)
    lifted = []
    for one in places:
        across, down = one[5] - one[0], one[24] - one[0]
        normal = np.cross(across, down) / np.linalg.norm(np.cross(across, down))
        lifted.append(one + board[:, 2:] * normal)
    points = np.stack(lifted)
    pixels = np.stack([camera.project(points.reshape(-1, 3))[0] for camera in cameras])
    pixels += 0.05 * np.random.default_rng(1).standard_normal(pixels.shape)
    case = replace(case, pixels=pixels.reshape(case.pixels.shape))
    write(tmp_path / "mine", case, np.eye(3), target=None, target_points="dots.csv")
    lines = [f"{i},{x},{y},{z}" for i, (x, y, z) in enumerate(board.tolist())]
    (tmp_path / "mine/dots.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *lines]))
    done = command("calibrate", "mine", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["noise_px"] == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(
    ("options", "changes", "words"),
    [
        (["--solver", "soloff"], {}, "solver soloff: expected known places of the target in every"),
        (["--unknowns", "k9"], {}, "--unknowns: expected auto, or names of principal_point, k1"),
        (["--unknowns", "wall"], {}, "wall: expected a wall and three points or more with known"),
        (
            ["--solver", "refractive_autocal_alternating", "--unknowns", "k1,bend"],
            {},
            "unknown: expected parameters of lenses for this solver, got bend: use refractive",
        ),
        (["-p", "thicknesses=[3]"], {}, "thicknesses: expected numbers from 0 and below 1"),
        ([], {"target": None}, "points.csv: line 2: expected x_mm, y_mm and z_mm of every point"),
        ([], {"target_points": "x.csv"}, "expected either target or target_points, got both"),
        ([], {"known": [{"frame": 9, "z_mm": 1.0}]}, "known.0: expected one of 6 frames"),
        ([], {"up": [0.0, 0.0, 0.0]}, "up: expected a vector of non-zero length"),
    ],
)
def test_a_fault_is_one_sentence(
    command: Command, tmp_path: Path, options: list[str], changes: Any, words: str
) -> None:
    case, _, _ = make_tank()
    write(tmp_path / "mine", case, np.eye(3), **changes)
    done = command("calibrate", "mine", *options)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert words in " ".join(done.stderr.split()), done.stderr
    assert not (tmp_path / "mine/result").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("flipped", "expected rows counted from the top of the images and columns from the left"),
        ("swapped", "are two cameras swapped, images mirrored, or a length wrong?"),
        ("inches", "expected points that one array can see, got some that miss by"),
    ],
)
def test_images_that_contradict_the_guess_are_a_sentence(
    command: Command, tmp_path: Path, what: str, words: str
) -> None:
    case, _, _ = make_tank()
    target = dict(BOARD)
    if what == "flipped":
        case.pixels[..., 1] = 799.0 - case.pixels[..., 1]
    elif what == "swapped":
        case = replace(case, pixels=case.pixels[[1, 0, 2]])
    else:
        target["pitch_mm"] = 10.0 / 25.4
    write(tmp_path / "mine", case, np.eye(3), target=target)
    done = command("calibrate", "mine")
    assert done.returncode == 2
    assert words in " ".join(done.stderr.split()), done.stderr


@pytest.mark.slow
def test_outliers_are_no_errors_of_held_out_frames(command: Command, tmp_path: Path) -> None:
    case, _, _ = make_tank()
    rng = np.random.default_rng(1)
    bad = rng.random(case.pixels.shape[:3]) < 0.1
    case.pixels[bad] += 30.0 * rng.standard_normal((int(bad.sum()), 2))
    write(tmp_path / "mine", case, np.eye(3))
    held_out = json.loads(command("calibrate", "mine", "--json").stdout)["held_out"]
    assert held_out["reprojection_px"] == pytest.approx(0.05, rel=0.3)
    assert held_out["rigidity_mm"] < 0.03
