"""Cameras of other programs, and their files."""

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.central_camera import CentralCamera
from sabench.geometry.grid import Grid
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.refraction import AnyWall, Layer, Wall
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.interop import openlpt, openptv
from sabench.interop.cameras import CameraFormat, read_cameras, write_cameras
from sabench.interop.foreign import ForeignFormatWarning, ForeignWorld, read_world
from sabench.interop.openptv_process import parameters
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.processes import python
from tests.conftest import pinholes
from tests.helpers.refusals import check_sentence, refused

pytestmark = pytest.mark.filterwarnings("ignore::sabench.interop.foreign.ForeignFormatWarning")
LENS = Distortion(k1=0.05, k2=-0.2, p1=1e-3, p2=-5e-4, k3=0.01)
TILT = (7.0, -11.0)


def rig(scene: str) -> tuple[tuple[Camera, ...], Grid, F64]:
    """Cameras, grid and points in it."""
    made = build_rig(load_scene(scene))
    grid, share = made.grid, np.random.default_rng(1).random((200, 3))
    size = np.asarray(grid.voxel_mm) * (np.asarray(grid.shape[::-1]) - 1)
    return pinholes(made.cameras), grid, np.asarray(grid.low_mm) + size * share


def walls(wall: AnyWall | None) -> dict[str, Wall | None]:
    """Walls that differ in what a format may get wrong."""
    assert isinstance(wall, Wall)
    normal = rotation_matrices(np.array([0.06, -0.04, 0.0])) @ np.array([0.0, 0.0, 1.0])
    two = Layer("glass", 1.52, 4.0), Layer("acrylic", 1.49, 2.0)
    return {
        "glass": wall,
        "none": None,
        "bare": dataclasses.replace(wall, layers=()),
        "two layers": dataclasses.replace(wall, layers=two),
        "tilted": dataclasses.replace(wall, normal=triple(normal)),
    }


NEAR_PX = 1e-6
SIZE = (240, 240)
CAMERAS, GRID, POINTS = rig("particle-tracking")


def changed(**fields: Any) -> list[Camera]:
    return [dataclasses.replace(camera, **fields) for camera in CAMERAS]


def difference_px(
    found: Sequence[CameraModel], true: Sequence[CameraModel], world: ForeignWorld
) -> float:
    """Largest distance of pixels of points over the volume."""
    seen = (one.project(world.into(POINTS))[0] for one in found)
    pairs = zip(seen, true, strict=True)
    return max(float(np.abs(pixel - one.project(POINTS)[0]).max()) for pixel, one in pairs)


CENTRED = {"distortion": LENS, "principal_point_px": (119.5, 119.5)}
ASIDE: dict[str, Any] = {"principal_point_px": (121.3, 117.8)}
ROUND_TRIPS = [
    ("openptv", {}),
    ("openptv", CENTRED),
    ("openptv", ASIDE | {"wall": None}),
    ("openptv", ASIDE | {"tilt_deg": TILT}),
    ("openptv", {"wall": walls(CAMERAS[0].wall)["tilted"]}),
    ("openlpt", ASIDE | {"distortion": LENS}),
    ("openlpt", {"wall": walls(CAMERAS[0].wall)["two layers"]}),
    ("openlpt", {"wall": walls(CAMERAS[0].wall)["bare"]}),
    ("myptv", ASIDE | {"wall": None}),
    ("opencv", ASIDE | {"wall": None, "distortion": LENS}),
    ("lpt-challenge", ASIDE | {"wall": None}),
    ("sabench-calibration", ASIDE | {"distortion": LENS, "tilt_deg": TILT}),
]


@pytest.mark.parametrize(("form", "fields"), ROUND_TRIPS)
def test_cameras_come_back(form: CameraFormat, fields: dict[str, object], tmp_path: Path) -> None:
    true = changed(**fields)
    write_cameras(tmp_path / "out", true, form, grid=GRID)
    found = read_cameras(tmp_path / "out", form, size=SIZE)
    assert [(one.rows, one.columns) for one in found] == [SIZE] * len(true)
    assert difference_px(found, true, read_world(tmp_path / "out")) < NEAR_PX


def test_points_through_a_wall_give_a_polynomial_camera(tmp_path: Path) -> None:
    write_cameras(tmp_path / "out", CAMERAS, "lpt-challenge", grid=GRID)
    with pytest.warns(ForeignFormatWarning) as said:
        found = read_cameras(tmp_path / "out", "lpt-challenge", size=SIZE)
    check_sentence(str(said[0].message), "camera 0", "4913")
    assert difference_px(found, CAMERAS, ForeignWorld()) < 1e-3


@pytest.mark.parametrize("form", ["openptv", "openlpt", "myptv", "opencv", "lpt-challenge"])
def test_losses_are_said(form: CameraFormat, tmp_path: Path) -> None:
    with pytest.warns(ForeignFormatWarning) as said:
        write_cameras(tmp_path / "out", changed(wall=None), form, grid=GRID)
    check_sentence(str(said[0].message), form)


REFUSED = [
    ("myptv", {}, "camera_00"),
    ("lpt-challenge", {}, ""),
    ("opencv", {}, "camera_00"),
    ("openptv", ASIDE | {"distortion": LENS}, "camera_00"),
    ("openlpt", {"distortion": Distortion(k1=-0.1)}, "camera_00"),
    ("matlab", {}, "matlab"),
    ("nonsense", {}, "cameras"),
]


@pytest.mark.parametrize(("form", "fields", "key"), REFUSED)
def test_what_would_project_elsewhere_is_refused(
    form: CameraFormat, fields: dict[str, object], key: str, tmp_path: Path
) -> None:
    with refused(key):
        write_cameras(tmp_path / "out", changed(**fields), form)
    assert not (tmp_path / "out").exists()


def test_a_fifth_camera_is_refused(tmp_path: Path) -> None:
    five = [*CAMERAS, dataclasses.replace(CAMERAS[0], name="camera_04")]
    with refused("openptv"):
        write_cameras(tmp_path / "out", five, "openptv", grid=GRID)


def openptv_project(folder: Path, fields: dict[str, object] | None = None) -> Path:
    write_cameras(folder, changed(**(fields or {})), "openptv", grid=GRID)
    return folder


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_openptv_projects_a_strange_lens_as_we_read_it(tmp_path: Path) -> None:
    """Distortion about the centre, a principal point elsewhere, shear, pixels not square."""
    optv = pytest.importorskip("optv.calibration", reason="needs the package optv")
    from optv.imgcoord import image_coordinates
    from optv.parameters import ControlParams
    from optv.transforms import convert_arr_metric_to_pixel

    root = openptv_project(tmp_path / "out", CENTRED)
    pitch = CAMERAS[0].pixel_mm
    par = root / "parameters" / "ptv.par"
    edit(par, f"{pitch}\n{pitch}", f"{pitch}\n{1.01 * pitch}")
    (root / "cal" / "cam1.tif.addpar").write_text("2e-4 -1e-6 0 1e-4 -2e-4 1.002 0.003\n")
    ori = root / "cal" / "cam1.tif.ori"
    lines = ori.read_text(encoding="utf-8").splitlines()
    lines[7] = "0.05 -0.03"
    ori.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (ours, *_) = read_cameras(root, "openptv")
    assert isinstance(ours, CentralCamera)
    control = ControlParams(len(CAMERAS))
    control.read_control_par(str(par))
    theirs = optv.Calibration()
    theirs.from_file(str(ori), str(root / "cal" / "cam1.tif.addpar"))
    points = read_world(root).into(POINTS)
    media = control.get_multimedia_params()
    metric = image_coordinates(np.ascontiguousarray(points), theirs, media)
    pixels = convert_arr_metric_to_pixel(metric, control) - 0.5
    assert np.abs(ours.project(points)[0] - pixels).max() < 1e-3
    rays = ours.back_project(ours.project(points)[0])
    away = np.cross(points - rays.origins_mm, rays.directions)
    assert rays.valid.all()
    assert np.abs(away).max() < 1e-6


def test_a_printed_rotation_is_made_orthonormal_and_said(tmp_path: Path) -> None:
    root = openptv_project(tmp_path / "out")
    ori = root / "cal" / "cam1.tif.ori"
    lines = ori.read_text(encoding="utf-8").splitlines()
    for row in (3, 4, 5):
        lines[row] = " ".join(f"{float(word):.6f}" for word in lines[row].split())
    ori.write_text("\r\n".join(lines) + "\r\n", encoding="latin-1")
    with pytest.warns(ForeignFormatWarning) as said:
        found = read_cameras(root, "openptv")
    check_sentence(str(said[0].message))
    assert isinstance(found[0], Camera)
    rotation = np.asarray(found[0].rotation)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert difference_px(found, CAMERAS, read_world(root)) < 0.01


def test_points_tell_exchanged_indices(tmp_path: Path) -> None:
    root = openptv_project(tmp_path / "out")
    points = read_world(root).into(POINTS)
    pixels = np.stack([camera.project(POINTS)[0] for camera in CAMERAS])
    pixels[1, 3:9] = np.nan
    wall = CAMERAS[0].wall
    assert wall is not None
    glass, water = wall.layers[0].index, wall.fluid_index
    for exchanged in (False, True):
        with pytest.warns(ForeignFormatWarning) as said:
            found = read_cameras(root, "openptv", points=(points, pixels))
        check_sentence(" ".join(str(one.message) for one in said))
        assert difference_px(found, CAMERAS, read_world(root)) < NEAR_PX
        if not exchanged:
            edit(root / "parameters" / "ptv.par", f"{glass}\n{water}", f"{water}\n{glass}")
    with refused("(4, 200, 2)"):
        read_cameras(root, "openptv", points=(points, pixels[:2]))


BROKEN = [
    ("parameters/ptv.par", None, "parameters/ptv.par"),
    ("parameters/ptv.par", "many\n", "ptv.par: line 1"),
    ("cal/cam2.tif.ori", None, "cam2.tif.ori"),
    ("cal/cam2.tif.ori", "1 2\n", "cam2.tif.ori"),
    ("cal/cam2.tif.ori", "1 2\n" * 9, "cam2.tif.ori: line 1"),
    ("cal/cam2.tif.addpar", "1 2 3\n", "cam2.tif.addpar"),
]


def test_cameras_json_of_a_calibration_has_the_limits_of_a_data_set(tmp_path: Path) -> None:
    write_cameras(tmp_path / "new", CAMERAS, "sabench-calibration")
    file = tmp_path / "new" / "cameras.json"
    record = json.loads(file.read_text(encoding="utf-8"))
    record["cameras"][1]["focal_length_mm"] = 1e300
    file.write_text(json.dumps(record), encoding="utf-8")
    with refused("cameras.focal_length_mm"):
        read_cameras(tmp_path / "new", "sabench-calibration")


@pytest.mark.parametrize(("name", "text", "key"), BROKEN)
def test_a_broken_project(name: str, text: str | None, key: str, tmp_path: Path) -> None:
    root = openptv_project(tmp_path / "out")
    (root / name).unlink()
    if text is not None:
        (root / name).write_text(text, encoding="utf-8")
    with refused(key):
        read_cameras(root, "openptv")


def test_metres_are_recognised(tmp_path: Path) -> None:
    far = changed(wall=None)
    near = {one.name: triple(np.asarray(one.center_mm) / 1e3) for one in far}
    small = [dataclasses.replace(one, center_mm=near[one.name]) for one in far]
    write_cameras(tmp_path / "out", small, "opencv")
    with refused():
        read_cameras(tmp_path / "out", "opencv")
    found = read_cameras(tmp_path / "out", "opencv", unit="m")
    assert difference_px(found, far, ForeignWorld()) < NEAR_PX


@pytest.mark.parametrize("kind", ["pinhole", "projective", "soloff"])
def test_points_in_metres_are_scaled(kind: str, tmp_path: Path) -> None:
    true = CAMERAS if kind == "soloff" else changed(wall=None)
    wide = np.array([1.01, 1.0]) if kind == "projective" else np.ones(2)
    pixels = [camera.project(POINTS)[0] * wide for camera in true]
    np.savetxt(tmp_path / "points.txt", np.hstack([POINTS / 1e3, *pixels]), fmt="%.17g")
    with refused():
        read_cameras(tmp_path / "points.txt", "lpt-challenge", size=SIZE)
    found = read_cameras(tmp_path / "points.txt", "lpt-challenge", size=SIZE, unit="m")
    names = {"pinhole": "Camera", "projective": "Projective", "soloff": "Soloff"}
    assert {type(one).__name__ for one in found} == {names[kind]}
    for camera, seen in zip(found, pixels, strict=True):
        assert np.abs(camera.project(POINTS)[0] - seen).max() < 1e-3


def write_opencv(path: Path, bent: F64, matrix: F64) -> tuple[F64, F64]:
    rotation, move = rotation_matrices(np.array([0.1, -0.2, 0.05])), np.array([3.0, -4.0, 500.0])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    values = {"K": matrix, "dist_coeffs": bent, "rotation_matrix": rotation, "tvec": move}
    for name, value in values.items():
        storage.write(name, value)
    storage.release()
    return rotation, move


@pytest.mark.parametrize(
    ("suffix", "count"), [(".yml", 4), (".xml", 5), (".json", 8), (".yml", 12), (".xml", 14)]
)
def test_opencv_projects_as_we_read_it(suffix: str, count: int, tmp_path: Path) -> None:
    terms = [0.05, -0.2, 1e-3, -5e-4, 0.01, 0.03, 0.01, 0.0, 1e-3, 2e-3, -1e-3, 1e-3, 0.02, -0.03]
    bent = np.array(terms[:count])
    matrix = np.array([[2000.0, 0.0, 120.0], [0.0, 2003.0, 118.0], [0.0, 0.0, 1.0]])
    rotation, move = write_opencv(tmp_path / f"left{suffix}", bent, matrix)
    (camera,) = read_cameras(tmp_path, "opencv", size=SIZE)
    points = np.random.default_rng(2).uniform(-20.0, 20.0, (100, 3))
    pixels = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], move, matrix, bent)[0][:, 0]
    assert isinstance(camera, CentralCamera)
    assert camera.name == "left"
    assert np.abs(camera.project(points)[0] - pixels).max() < NEAR_PX


def test_a_lens_without_a_place_is_refused(tmp_path: Path) -> None:
    storage = cv2.FileStorage(str(tmp_path / "cam.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", np.eye(3))
    storage.release()
    with refused("cam.yml"):
        read_cameras(tmp_path / "cam.yml", "opencv", size=SIZE)
    (tmp_path / "cam.yml").write_text("%YAML:1.0\n---\nK: [1, 2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"cam\.yml"):  # the sentence ends in OpenCV's own
        read_cameras(tmp_path / "cam.yml", "opencv", size=SIZE)


def test_myptvs_correction_bends_lines_of_sight(tmp_path: Path) -> None:
    (one, *_) = changed(wall=None)
    write_cameras(tmp_path / "out", [one], "myptv")
    file = tmp_path / "out" / one.name
    lines = file.read_text(encoding="utf-8").splitlines()
    table = np.array([[1e-3, 2e-4, 1e-6, -2e-6, 1e-6], [3e-4, -1e-3, 2e-6, 1e-6, -1e-6]])
    for number, values in enumerate(table, 7):
        lines[number] = " ".join(map(str, values)) + " "
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    (camera,) = read_cameras(tmp_path / "out", "myptv")
    assert isinstance(camera, CentralCamera)
    column, row = 31.0, 205.5
    terms = np.array([column, row, column**2, row**2, column * row])
    middle = np.asarray(one.principal_point_px)
    along = np.array([*(np.array([column, row]) - middle + table @ terms), one.focal_px])
    direction = along @ np.asarray(one.rotation) / np.linalg.norm(along)
    np.testing.assert_allclose(camera.directions([[column, row]])[0][0], direction, atol=1e-10)
    (tmp_path / "old").mkdir()  # files of the first versions have no model and no size
    older = "\n".join([lines[1], *lines[3:]]) + "\n"
    (tmp_path / "old" / "cam1").write_text(older, encoding="utf-8")
    (same,) = read_cameras(tmp_path / "old", "myptv", size=SIZE)
    np.testing.assert_allclose(same.project(POINTS)[0], camera.project(POINTS)[0], atol=1e-9)


def test_a_zolof_camera_needs_its_volume(tmp_path: Path) -> None:
    table = np.random.default_rng(3).normal(size=(19, 2))
    lines = [f"A {i} {j} \t {table[i, j]} " for i in range(19) for j in range(2)]
    text = "\n".join(["extendedZolof model camera", "cam3", "O 0 \t 1.0 ", *lines])
    (tmp_path / "cam3").write_text(text, encoding="utf-8")
    with refused("cam3"):
        read_cameras(tmp_path, "myptv")
    with refused():
        read_cameras(tmp_path, "myptv", size=SIZE)
    (camera,) = read_cameras(tmp_path, "myptv", size=SIZE, grid=GRID)
    x, y, z = POINTS.T
    terms = [1 + 0 * x, x, y, z, x**2, y**2, z**2, x * y, y * z, z * x, x * y * z]
    terms += [x * y**2, x * z**2, y * x**2, y * z**2, z * x**2, z * y**2, x**3, y**3]
    expected = np.stack(terms, axis=1) @ table
    np.testing.assert_allclose(camera.project(POINTS)[0], expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("old", [False, True])
def test_matlabs_structures_are_read(old: bool, tmp_path: Path) -> None:
    true = changed(wall=None, distortion=dataclasses.replace(LENS, k3=0.0), **ASIDE)
    content = {}
    for camera in true:
        rotation, focal = np.asarray(camera.rotation), camera.focal_px
        column, row = camera.principal_point_px
        matrix = np.array([[focal, 0.0, column + 1.0], [0.0, focal, row + 1.0], [0.0, 0.0, 1.0]])
        move = -rotation @ np.asarray(camera.center_mm)
        lens = camera.distortion
        place = {"RotationMatrix": rotation.T, "TranslationVector": move[None]}
        content[camera.name] = {
            "RadialDistortion": np.array([[lens.k1, lens.k2]]),
            "TangentialDistortion": np.array([[lens.p1, lens.p2]]),
            "ImageSize": np.array([[240, 240]]),
            **({"IntrinsicMatrix": matrix.T} if old else {"K": matrix}),
            **(place if old else {"R": rotation, "t": move[:, None]}),
        }
    savemat(tmp_path / "cameras.mat", content)
    found = read_cameras(tmp_path / "cameras.mat", "matlab")
    assert [camera.name for camera in found] == [camera.name for camera in true]
    assert difference_px(found, true, ForeignWorld()) < NEAR_PX
    savemat(tmp_path / "other.mat", {"x": 1.0})
    with refused():
        read_cameras(tmp_path / "other.mat", "matlab")


def test_polynomials_replace_cameras_behind_a_wall(tmp_path: Path) -> None:
    with pytest.warns(ForeignFormatWarning) as said:
        write_cameras(tmp_path / "out", CAMERAS, "myptv", grid=GRID)
    check_sentence(str(said[0].message), *(camera.name for camera in CAMERAS))
    found = read_cameras(tmp_path / "out", "myptv", size=SIZE, grid=GRID)
    assert difference_px(found, CAMERAS, ForeignWorld()) < 1e-3


CLOSE_PX = 1e-3
# Every wall with an ideal lens, and a distorted one and a tilted sensor behind three of them
OPTICS = [(kind, Distortion(), UPRIGHT) for kind in ("glass", "none", "bare", "tilted")]
OPTICS += [(kind, LENS, UPRIGHT) for kind in ("glass", "none", "tilted")]
OPTICS += [(kind, Distortion(), TILT) for kind in ("glass", "none", "tilted")]


@pytest.mark.parametrize(
    ("kind", "lens", "tilt"),
    [*OPTICS, ("two layers", LENS, UPRIGHT), ("two layers", Distortion(), TILT)],
)
def test_openlpt_agrees(
    kind: str, lens: Distortion, tilt: tuple[float, float], tmp_path: Path
) -> None:
    lpt = pytest.importorskip("pyopenlpt")
    for camera in CAMERAS:
        wall = walls(camera.wall)[kind]
        own = dataclasses.replace(camera, wall=wall, distortion=lens, tilt_deg=tilt, **ASIDE)
        (tmp_path / "cam.txt").write_text(openlpt.camera_text(own), encoding="utf-8")
        model = lpt.loadCameraModel(str(tmp_path / "cam.txt"))
        seen = model.projectBatchStatus([lpt.Pt3D(*point) for point in POINTS])
        pixels = np.array([np.ravel(pixel.to_list()) for _, pixel, _ in seen])
        assert np.abs(pixels - own.project(POINTS)[0]).max() < CLOSE_PX


@pytest.mark.parametrize(("kind", "lens", "tilt"), OPTICS)
def test_openptv_agrees(
    kind: str, lens: Distortion, tilt: tuple[float, float], tmp_path: Path
) -> None:
    pytest.importorskip("optv")
    from optv.imgcoord import image_coordinates
    from optv.transforms import convert_arr_metric_to_pixel

    off = (119.5, 119.5) if lens == LENS else (121.3, 117.8)
    wall = walls(CAMERAS[0].wall)[kind]
    own = tuple(changed(wall=wall, distortion=lens, principal_point_px=off, tilt_deg=tilt))
    openptv.write_project(tmp_path, own, GRID, 1, openptv.Settings(10, 5, 1.0, 0.5, 0.2, 100.0))
    project = json.loads((tmp_path / "project.json").read_text(encoding="utf-8"))
    theirs, control, _ = parameters(tmp_path, project)
    there = np.ascontiguousarray(openptv.world_of(GRID).into(POINTS))
    for camera, other in zip(own, theirs, strict=True):
        metric = image_coordinates(there, other, control.get_multimedia_params())
        pixels = convert_arr_metric_to_pixel(metric, control) - 0.5
        assert np.abs(pixels - camera.project(POINTS)[0]).max() < CLOSE_PX


def test_what_a_format_cannot_say_is_said() -> None:
    one = CAMERAS[0]
    two = dataclasses.replace(one, wall=walls(one.wall)["two layers"])
    leaning = dataclasses.replace(one, distortion=LENS, tilt_deg=TILT)
    finer = dataclasses.replace(CAMERAS[1], pixel_mm=one.pixel_mm / 2.0)
    assert openptv.unlike(CAMERAS[:2]) is None
    for sentence, key in (
        (openptv.unfit(two), "OpenPTV"),
        (openptv.unfit(leaning), "OpenPTV"),
        (openlpt.unfit(leaning), "OpenLPT"),
        (openptv.unlike([one, finer]), "camera_01"),
    ):
        check_sentence(str(sentence), key)
    with refused("camera_00", kind=ValueError):
        openptv.orientation_text(two, openptv.world_of(GRID))
    with refused("camera_00", kind=ValueError):
        openlpt.camera_text(leaning)


def test_links_make_tracks() -> None:
    tracks = openptv.join_links([3, 3, 2], [[], [-1, 0, 2], [1, 1]])
    assert tracks[0].tolist() == [0, 1, 2]
    assert tracks[1].tolist() == [3, 0, 2]
    assert tracks[2].tolist() == [0, 4]  # two that claim one: the first has it


def test_openlpts_tracks_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "results" / "ConvergeTrack"
    folder.mkdir(parents=True)
    head = "TrackID,FrameID,WorldX,WorldY,WorldZ\n"
    (folder / "LongTrackActive_2.csv").write_text(
        head + "0,0,1.0,2.0,3.0,9,9\n0,1,1.5,2.0,3.0,9,9\n1,1,7.0,8.0,9.0,9,9\n", encoding="utf-8"
    )
    (folder / "ExitTrack_2.csv").write_text(head + "0,0,4.0,5.0,6.0,9,9\n", encoding="utf-8")
    first, second, third = openlpt.read_result(tmp_path, 3)
    np.testing.assert_array_equal(first.position_mm, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    for found, expected in ((first, [0, 2]), (second, [0, 1])):
        np.testing.assert_array_equal(np.asarray(found.trajectory), expected)
    assert len(third.position_mm) == 0


@pytest.mark.parametrize(
    ("code", "key"),
    [("import os; os.abort()", "SIGABRT"), ("raise SystemExit('no licence')", "no licence")],
)
def test_crashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, key: str) -> None:
    (tmp_path / "crashes.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with refused(key):
        python.run_module("crashes", tmp_path, "the program", "x", 1)


def test_a_missing_package_is_one_sentence() -> None:
    assert python.missing_package("sys", "python") is None
    check_sentence(str(python.missing_package("no_such_module", "nothing")), "nothing")
