"""The command sabench calibrate: folders with points or images, tanks, and unknown walls."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w
from pydantic import TypeAdapter

import sabench
from sabench.api import CalibrationCase
from sabench.dataset.cameras import write_cameras
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.scenes.illumination import Lighting
from sabench.simulation.rendering.targets_traced import render
from sabench.utils.arrays import F64
from sabench.worlds.calibration_targets import pose_target
from tests.conftest import Command
from tests.helpers import calibration_cases
from tests.helpers.calibration_tanks import MIDDLE, make_tank, off_wall, rotated, with_places
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import refused


def write_toml(
    folder: Path, cameras: tuple[Any, ...], aim_mm: list[float], step: float, values: dict[str, Any]
) -> None:
    """Write calibration.toml as an experimenter with a ruler would."""
    listed = [
        {"name": c.name, "center_mm": [round(v / step) * step for v in c.center_mm]}
        | {"aim_mm": aim_mm}
        for c in cameras
    ]
    kept = {key: one for key, one in ({"cameras": listed} | values).items() if one is not None}
    folder.mkdir(exist_ok=True)
    (folder / "calibration.toml").write_text(tomli_w.dumps(kept))


def describe(scene: Scene, folder: Path, cameras: tuple[Camera, ...], **changes: Any) -> None:
    target, spec = dict(scene.targets or {}), scene.cameras
    array = {key: getattr(spec, key) for key in ("rows", "columns", "pixel_mm")}
    values: dict[str, Any] = {
        "target_mm": [0.0, 0.0, 35.0],
        "target": {key: target[key] for key in ("pattern", "columns", "rows", "pitch_mm")},
        "array": array | {"focal_length_mm": 85.0, "principal_distance_mm": 100.0},
        "wall": {"fluid_index": 1.333, "layers": [{"index": 1.5, "thickness_mm": 5.0}]},
    }
    write_toml(folder, cameras, [2.0, -2.0, 30.0], 10.0, values | changes)


def cameras_in(path: Path) -> tuple[Camera, ...]:
    content = json.loads(path.read_text())
    assert (content["format"], content["version"]) == ("sabench-dataset", 1)
    records = [{**record, "wall": content["wall"]} for record in content["cameras"]]
    return tuple(TypeAdapter(Camera).validate_python(record) for record in records)


@pytest.mark.slow
def test_a_round_tank_is_calibrated(command: Command, tmp_path: Path) -> None:
    """Three cameras in front of a cylinder, which the report and cameras.json keep."""
    wall = {"shape": "cylinder", "axis_point_mm": [0.0, 0.0, 90.0], "outer_radius_mm": 90.0}
    wall |= {"fluid_index": 1.333, "layers": [{"index": 1.5, "thickness_mm": 5.0}]}
    layout = {"kind": "line", "count": 3, "spacing_mm": 150.0}
    target = {"generator": "boards", "pattern": "checkerboard", "pitch_mm": 9.0}
    scene = calibration_cases.calibration_scene(
        targets={**target, "columns": 5, "rows": 5}, cameras={"layout": layout}, calibration=None
    )
    values = scene.to_dict() | {"wall": wall}
    case, cameras, _, _ = calibration_cases.case_of(parse_scene(values, "round"))
    known = [{"frame": 2, "point": 12, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 35.0}]
    describe(scene, tmp_path / "mine", cameras, wall=wall, known=known)
    calibration_cases.write_points(tmp_path / "mine" / "points.csv", case.pixels, cameras)
    succeed(command("calibrate", str(tmp_path / "mine")))
    content = json.loads((tmp_path / "mine" / "result" / "cameras.json").read_text())
    assert content["wall"]["outer_radius_mm"] == 90.0
    report = json.loads((tmp_path / "mine" / "result" / "report.json").read_text())
    assert report["noise_px"] == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_points_become_cameras(command: Command, tmp_path: Path) -> None:
    scene = calibration_cases.calibration_scene(
        detection={"noise_px": 0.2, "missing": 0.05, "outliers": 0.02}
    )
    case, cameras, points, exact = calibration_cases.case_of(scene)
    places = dict(zip(("x_mm", "y_mm", "z_mm"), points[2, 60].tolist(), strict=True))
    describe(scene, tmp_path / "mine", cameras, known=[{"frame": 2, "point": 60} | places])
    calibration_cases.write_points(tmp_path / "mine" / "points.csv", case.pixels, cameras)
    report = json.loads(succeed(command("calibrate", "mine", "--json")).stdout)
    assert report["noise_px"] == pytest.approx(0.2, rel=0.05)
    assert report["depth_mm"] < 0.1
    assert len(report["cameras"]) == 9
    used, found = (sum(line[key] for line in report["frames"]) for key in ("used", "found"))
    assert 0.9 < used / found < 1.0
    made = cameras_in(tmp_path / "mine" / "result" / "cameras.json")
    depth = np.mean(
        [own.center_mm[2] - true.center_mm[2] for own, true in zip(made, cameras, strict=True)]
    )
    assert abs(depth) < 0.5
    # turned about the normal, which one known point leaves open
    assert calibration_cases.true_error_px(made, points, exact) < 40.0
    assert (tmp_path / "mine/result/errors.png").read_bytes().startswith(b"\x89PNG")
    assert command("calibrate", "mine").returncode == 2  # the result is there
    assert "expected true error" in succeed(command("calibrate", "mine", "--overwrite")).stdout


@pytest.mark.slow
def test_images_become_cameras(command: Command, tmp_path: Path) -> None:
    places = ((-150.0, -80.0), (150.0, -80.0), (0.0, 150.0))
    layout = {"kind": "list", "places": [{"center_mm": [x, y, -490.0]} for x, y in places]}
    scene = calibration_cases.calibration_scene(
        cameras={"rows": 600, "columns": 600, "pixel_mm": 0.02, "layout": layout},
        targets={"pitch_mm": 3.2},
    )
    lamps = Lighting.model_validate(
        {"lamps": [{"center_mm": [-300.0, -100.0, -400.0]}, {"center_mm": [300.0, 100.0, -400.0]}]}
    )
    cameras, placed = build_rig(scene).cameras, pose_target(scene, 1)
    describe(scene, tmp_path / "mine", cameras)
    for frame, pose in enumerate(placed.poses):
        folder = tmp_path / "mine" / "images" / f"frame_{frame}"
        folder.mkdir(parents=True)
        for camera in cameras:
            picture = render(camera, placed.target, pose, lamps, np.array([0.0, 0.0, 35.0]), 9)
            grey = np.clip(200.0 * picture, 0.0, 255.0).astype(np.uint8)
            assert cv2.imwrite(str(folder / f"{camera.name}.png"), grey)
    report = json.loads(succeed(command("calibrate", "mine", "-o", "out", "--json")).stdout)
    assert report["noise_px"] < 0.05
    assert all(
        line["found"] >= 484 and line["used"] > 0.9 * line["found"] for line in report["cameras"]
    ), report
    found, true = (
        [camera.principal_distance_mm for camera in own]
        for own in (cameras_in(tmp_path / "out" / "cameras.json"), cameras)
    )
    np.testing.assert_allclose(found, true, rtol=0.02)


LINES = ("camera,frame,point,column,row", "camera_00,0,0,1.5,2.5")


@pytest.mark.parametrize(
    ("lines", "changes", "key"),
    [
        (LINES, None, "calibration.toml"),
        (LINES, ("pitch_mm", "pich_mm"), "calibration.toml: target.pich_mm"),
        (LINES, ("[wall]", "[wall]\npoint_mm = [0.0, 0.0, -900.0]"), "camera camera_00"),
        (("camera,frame,point,x,y", LINES[1]), (), "points.csv"),
        ((*LINES, "camera_00,0,one,1,1"), (), "points.csv: line 3: point"),
        ((*LINES, "camera_77,0,1,1,1"), (), "points.csv: line 3"),
        ((*LINES, LINES[1]), (), "camera_00, frame 0"),
        ((), (), "images"),
        (LINES, (), "camera_01"),
    ],
    ids=["configuration", "key", "wall", "header", "number", "camera", "twice", "images", "few"],
)
def test_a_fault_is_one_sentence(
    command: Command, tmp_path: Path, lines: tuple[str, ...], changes: Any, key: str
) -> None:
    scene, folder = calibration_cases.calibration_scene(), tmp_path / "mine"
    describe(scene, folder, build_rig(scene).cameras)
    text = (folder / "calibration.toml").read_text()
    if changes is None:
        (folder / "calibration.toml").unlink()
    elif changes:
        (folder / "calibration.toml").write_text(text.replace(*changes))
    if lines:
        (folder / "points.csv").write_text("\n".join(lines) + "\n")
    refuse(command("calibrate", "mine"), key)
    assert not (folder / "result").exists()


Y_UP = np.diag([1.0, -1.0, -1.0])  # Y up, Z towards the cameras
NO_CAMERAS: dict[str, Any] = {"array": None, "cameras": None, "target_mm": [0.0, 0.0, 70.0]}
HEAD = ["camera", "frame", "point", "column", "row"]
BOARD = {"pattern": "checkerboard", "columns": 6, "rows": 5, "pitch_mm": 10.0}


def write(folder: Path, case: CalibrationCase, rotation: F64, **changes: Any) -> None:
    wall = case.cameras[0].wall
    assert isinstance(wall, Wall)
    values: dict[str, Any] = {
        "target": BOARD,
        "array": {"rows": 800, "columns": 900, "pixel_mm": 0.01, "focal_length_mm": 50.0},
        "wall": {"point_mm": list(wall.point_mm), "normal": list(wall.normal)}
        | {"fluid_index": 1.333, "layers": [{"index": 1.5, "thickness_mm": 8.0}]},
    }
    write_toml(folder, case.cameras, (rotation @ MIDDLE).tolist(), 1, values | changes)
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
    done = succeed(command("calibrate", "mine"))
    first = done.stdout.splitlines()[0]
    assert first.startswith("The boards do not show how far they are from the wall")
    assert "Measure the distance of one point" in " ".join(done.stdout.split())
    report = json.loads((tmp_path / "mine/result/report.json").read_text())
    assert report["held_out"]["frames"] == 6
    assert report["held_out"]["reprojection_px"] == pytest.approx(0.05, rel=0.3)


@pytest.mark.slow
def test_a_world_with_y_up_and_its_places_enter(command: Command, tmp_path: Path) -> None:
    """The nominal wall is 40 mm off; held-out boards choose its place and k1."""
    case, _, places = make_tank(k1=-0.5)
    case = rotated(off_wall(with_places(case, places), -40.0), Y_UP)
    write(tmp_path / "mine", case, Y_UP, up=[0.0, 1.0, 0.0])
    done = succeed(command("calibrate", "mine", "--unknowns", "auto"))
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
def test_solvers_of_known_places(
    command: Command, tmp_path: Path, solver: str, target: Any
) -> None:
    case, _, places = make_tank()
    write(tmp_path / "mine", with_places(case, places), np.eye(3), target=target)
    report = json.loads(succeed(command("calibrate", "mine", "--solver", solver, "--json")).stdout)
    limit = 0.3 if solver == "pinhole_linear" else 0.15  # straight lines through a flat glass
    assert report["noise_px"] < limit
    assert report["held_out"]["known_mm"] < 2.0 * limit
    assert len(json.loads((tmp_path / "mine/result/cameras.json").read_text())["cameras"]) == 3


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
    done = succeed(command("calibrate", "mine", "--json"))
    assert json.loads(done.stdout)["noise_px"] == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(
    ("options", "changes", "key"),
    [
        ("--solver soloff", {}, "soloff"),
        ("--unknowns k9", {}, "--unknowns"),
        ("--unknowns wall", {}, "wall"),
        ("--solver refractive_autocal_alternating --unknowns k1,bend", {}, "bend"),
        ("-p thicknesses=[3]", {}, "thicknesses"),
        ("", {"target_points": "x.csv"}, "target_points"),
        ("", {"known": [{"frame": 9, "z_mm": 1.0}]}, "known.0"),
        ("", {"up": [0.0, 0.0, 0.0]}, "up"),
        ("", {"known_cameras": "air.json"}, "known_cameras"),
        ("", {"array": None}, "array"),
        ("", {"array": None, "cameras": None, "known_cameras": "air.json"}, "target_mm"),
        ("", NO_CAMERAS | {"known_cameras": "no.json"}, "no.json"),
    ],
)
def test_a_fault_of_a_tank_is_one_sentence(
    command: Command, tmp_path: Path, options: str, changes: Any, key: str
) -> None:
    case, _, _ = make_tank()
    write(tmp_path / "mine", case, np.eye(3), **changes)
    refuse(command("calibrate", "mine", *options.split()), key)
    assert not (tmp_path / "mine/result").exists()


@pytest.mark.slow
@pytest.mark.parametrize("what", ["flipped", "swapped", "inches"])
def test_images_that_contradict_the_guess_are_a_sentence(
    command: Command, tmp_path: Path, what: str
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
    refuse(command("calibrate", "mine"))


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


ERRORS: dict[str, Any] = {"wall_mm": 3.0, "wall_deg": 0.5, "thickness_percent": 5.0}
ERRORS |= {"layer_index": 0.01, "fluid_index": 0.003}
ERRORS |= {"unknown": ["wall", "thickness", "layer_index", "fluid_index"]}
KNOWN = [{"frame": frame, "point": point} for frame in range(5) for point in (0, 10, 60, 110, 120)]
EXACT: dict[str, Any] = {"center_mm": 0.0, "turn_deg": 0.0, "focal_percent": 0.0}


def test_a_data_set_holds_the_nominal_wall_and_the_true_one(tmp_path: Path) -> None:
    known = EXACT | {"known_cameras": True, "known": KNOWN, "unknown": ["wall"]}
    errors = {"wall_mm": 3.0, "wall_deg": 0.5}
    scene = calibration_cases.calibration_scene(calibration=known | errors)
    data = sabench.generate(scene, tmp_path / "boards", seed=1, backend="splat")
    case = data.calibration_case()
    nominal, true = case.cameras[0].wall, data.true_cameras[0].wall
    assert isinstance(nominal, Wall)
    assert isinstance(true, Wall)
    assert case.known_cameras
    assert nominal != true
    assert replace(case.cameras[0], wall=true) == data.true_cameras[0]
    before = sabench.score(data, "empty")
    after = sabench.score(data, sabench.solve("refractive_autocal", data, tmp_path / "r.h5").path)
    for name in ("wall_place_error_mm", "wall_tilt_error_deg"):
        assert 0.0 < after[name] < 0.05 * before[name]
    assert after["true_ratio"] == pytest.approx(1.0, abs=0.3)


def test_solvers_of_lenses_decline_an_unknown_wall(tmp_path: Path) -> None:
    scene = calibration_cases.calibration_scene(calibration=ERRORS | {"known": KNOWN})
    data = sabench.generate(scene, tmp_path / "boards", seed=1, backend="splat")
    assert sabench.score(data, "truth")["bound_px"] > 0.0
    with refused("refractive_autocal_alternating"):
        sabench.solve("refractive_autocal_alternating", data, tmp_path / "r.h5")


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"calibration": {"known_cameras": True}}, "known_cameras"),
        ({"calibration": EXACT | {"known_cameras": True, "unknown": ["k1"]}}, "known_cameras"),
        ({"calibration": {"wall_mm": 1.0}, "wall": None}, "wall"),
        ({"calibration": {"thickness_percent": 50.0}}, "thickness_percent"),
    ],
)
def test_impossible_errors_are_a_sentence(changes: dict[str, Any], key: str) -> None:
    with refused(key):
        calibration_cases.calibration_scene(**changes)


@pytest.mark.slow
def test_a_folder_with_known_cameras_finds_its_wall(command: Command, tmp_path: Path) -> None:
    case, cameras, places = make_tank()
    folder = tmp_path / "mine"
    changes = NO_CAMERAS | {"known_cameras": "air.json", "unknown": ["wall"]}
    wall = {"point_mm": [0.0, 0.0, -4.0], "fluid_index": 1.333}
    wall |= {"layers": [{"index": 1.5, "thickness_mm": 8.0}]}
    write(folder, with_places(case, places), np.eye(3), **changes, wall=wall)
    write_cameras(folder / "air.json", cameras)
    done = succeed(command("calibrate", "mine"))
    assert "tilt of the wall about X" in done.stdout
    place = json.loads((folder / "result/report.json").read_text())["wall"][-1]
    assert place["name"] == "place of the wall"
    assert place["found"] == pytest.approx(4.0, abs=4.0 * place["std"])
    made = json.loads((folder / "result/cameras.json").read_text())["cameras"]
    for entry, camera in zip(made, cameras, strict=True):
        np.testing.assert_allclose(entry["center_mm"], camera.center_mm, atol=1e-9)
    done = succeed(
        command("calibrate", "mine", "-o", "again", "--unknowns", "wall,thickness,layer_index")
    )
    first = " ".join(done.stdout.split())
    assert "The data hardly show the index of" in first
    assert "(standard deviation" in first
