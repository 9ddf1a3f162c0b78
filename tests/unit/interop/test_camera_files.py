"""Cameras in other programs' formats.

Those programs' code projects points to the same pixels as sabench.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.refraction import AnyWall, Layer, Wall
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.interop import openlpt, openptv
from sabench.interop.openptv_process import parameters
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.processes import python
from tests.conftest import pinholes

NEAR_PX = 1e-3
LENS = Distortion(k1=0.05, k2=-0.2, p1=1e-3, p2=-5e-4, k3=0.01)
TILT = (7.0, -11.0)
OPTICS = [(Distortion(), UPRIGHT), (LENS, UPRIGHT), (Distortion(), TILT)]
OPTICS_IDS = ["ideal", "distorted", "tilted sensor"]


def rig(scene: str) -> tuple[tuple[Camera, ...], Grid, F64]:
    """Cameras, grid and points in it."""
    made = build_rig(load_scene(scene))
    grid = made.grid
    size = np.asarray(grid.voxel_mm) * (np.asarray(grid.shape[::-1]) - 1)
    return (
        pinholes(made.cameras),
        grid,
        np.asarray(grid.low_mm) + size * np.random.default_rng(1).random((200, 3)),
    )


def walls(wall: AnyWall | None) -> dict[str, Wall | None]:
    """Walls that differ in what a format may get wrong."""
    assert isinstance(wall, Wall)
    normal = rotation_matrices(np.array([0.06, -0.04, 0.0])) @ np.array([0.0, 0.0, 1.0])
    return {
        "glass": wall,
        "none": None,
        "bare": dataclasses.replace(wall, layers=()),
        "two layers": dataclasses.replace(
            wall, layers=(Layer("glass", 1.52, 4.0), Layer("acrylic", 1.49, 2.0))
        ),
        "tilted": dataclasses.replace(wall, normal=triple(normal)),
    }


@pytest.mark.parametrize(("lens", "tilt"), OPTICS, ids=OPTICS_IDS)
@pytest.mark.parametrize("kind", ["glass", "none", "bare", "two layers", "tilted"])
def test_openlpt_projects_as_we_do(
    kind: str, lens: Distortion, tilt: tuple[float, float], tmp_path: Path
) -> None:
    lpt = pytest.importorskip("pyopenlpt")
    cameras, _, points = rig("particle-tracking")
    for camera in cameras:
        own = dataclasses.replace(
            camera,
            wall=walls(camera.wall)[kind],
            distortion=lens,
            principal_point_px=(121.3, 117.8),
            tilt_deg=tilt,
        )
        (tmp_path / "cam.txt").write_text(openlpt.camera_text(own), encoding="utf-8")
        seen = lpt.loadCameraModel(str(tmp_path / "cam.txt")).projectBatchStatus(
            [lpt.Pt3D(*point) for point in points]
        )
        pixels = np.array([np.ravel(pixel.to_list()) for _, pixel, _ in seen])
        assert np.abs(pixels - own.project(points)[0]).max() < NEAR_PX


@pytest.mark.parametrize(("lens", "tilt"), OPTICS, ids=OPTICS_IDS)
@pytest.mark.parametrize("kind", ["glass", "none", "bare", "tilted"])
def test_openptv_projects_as_we_do(
    kind: str, lens: Distortion, tilt: tuple[float, float], tmp_path: Path
) -> None:
    pytest.importorskip("optv")
    from optv.imgcoord import image_coordinates
    from optv.transforms import convert_arr_metric_to_pixel

    cameras, grid, points = rig("particle-tracking")
    off = (119.5, 119.5) if lens == LENS else (121.3, 117.8)
    own = tuple(
        dataclasses.replace(
            one,
            wall=walls(one.wall)[kind],
            distortion=lens,
            principal_point_px=off,
            tilt_deg=tilt,
        )
        for one in cameras
    )
    openptv.write_project(tmp_path, own, grid, 1, openptv.Settings(10, 5, 1.0, 0.5, 0.2, 100.0))
    theirs, control, _ = parameters(
        tmp_path, json.loads((tmp_path / "project.json").read_text(encoding="utf-8"))
    )
    for camera, other in zip(own, theirs, strict=True):
        there = np.ascontiguousarray(openptv.world_of(grid).into(points))
        pixels = (
            convert_arr_metric_to_pixel(
                image_coordinates(there, other, control.get_multimedia_params()), control
            )
            - 0.5
        )
        assert np.abs(pixels - camera.project(points)[0]).max() < NEAR_PX


def test_what_a_format_cannot_say_is_said() -> None:
    cameras, grid, _ = rig("particle-tracking")
    two = dataclasses.replace(cameras[0], wall=walls(cameras[0].wall)["two layers"])
    assert openptv.unfit(two) == "OpenPTV supports one layer of glass, and this wall has 2"
    beside = dataclasses.replace(cameras[0], distortion=LENS, principal_point_px=(121.3, 117.8))
    assert "about the centre of the image" in str(openptv.unfit(beside))
    with pytest.raises(ValueError, match="camera_00: OpenPTV supports one layer of glass"):
        openptv.orientation_text(two, openptv.world_of(grid))
    barrel = dataclasses.replace(cameras[0], distortion=Distortion(k1=-0.1))
    assert "without a positive coefficient" in str(openlpt.unfit(barrel))
    leaning = dataclasses.replace(cameras[0], distortion=LENS, tilt_deg=TILT)
    for program, name in ((openlpt, "OpenLPT"), (openptv, "OpenPTV")):
        expected = f"{name} has no tilted sensor behind a lens with distortion"
        assert program.unfit(leaning) == expected
    with pytest.raises(ValueError, match="camera_00: OpenLPT has no tilted sensor"):
        openlpt.camera_text(leaning)
    finer = dataclasses.replace(cameras[1], pixel_mm=cameras[0].pixel_mm / 2.0)
    assert openptv.unlike(cameras[:2]) is None
    assert "one pixel pitch, and camera_01 has" in str(openptv.unlike([cameras[0], finer]))


def test_points_come_back_from_openptvs_world() -> None:
    _, grid, points = rig("particle-tracking")
    world = openptv.world_of(grid)
    np.testing.assert_allclose(world.back(world.into(points)), points, atol=1e-12)


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
    assert first.trajectory is not None
    assert second.trajectory is not None
    assert (first.trajectory.tolist(), second.trajectory.tolist(), len(third.position_mm)) == (
        [0, 2],
        [0, 1],
        0,
    )


CRASHES = [
    ("import os; os.abort()", "signal SIGABRT"),
    ("raise SystemExit('no licence')", "exit code 1; its last words: no licence"),
]


@pytest.mark.parametrize(("code", "said"), CRASHES)
def test_a_crash_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, said: str
) -> None:
    (tmp_path / "crashes.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(
        InputError, match=f"the program: expected exit code 0, but it ended with {said}"
    ):
        python.run_module("crashes", tmp_path, "the program", "x", 1)


def test_a_missing_package_is_one_sentence() -> None:
    assert python.missing("sys", "python") is None
    assert (
        python.missing("no_such_module", "nothing")
        == "the package nothing is not installed: pip install sabench[competitors]"
    )
