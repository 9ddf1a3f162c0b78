"""Lenses and sensors of single cameras of a scene."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import sabench
from sabench.dataset.cameras import read_cameras
from sabench.geometry.lens import Distortion
from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.scenes.focusing import nominal_cameras
from tests.helpers.refusals import refused

OWN: dict[str, Any] = {"camera": "camera_02", "focal_length_mm": 60.0, "f_number": 8.0}
OWN |= {"distortion": {"k1": -0.3, "p2": 0.01}, "principal_point_px": [150.25, 128.5]}
OWN |= {"pixel_mm": 0.015, "tilt_deg": [4.0, -6.0]}


def scene_with(*each: dict[str, Any], **tables: Any) -> Scene:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    if each:
        values["cameras"]["each"] = list(each)
    return parse_scene(values | tables, "test")


def test_one_camera_has_the_lens_and_the_sensor_of_its_own_table() -> None:
    plain, own = (build_rig(scene).cameras for scene in (scene_with(), scene_with(OWN)))
    assert [*own[:2], *own[3:]] == [*plain[:2], *plain[3:]]
    camera = own[2]
    assert (camera.focal_length_mm, camera.f_number, camera.pixel_mm) == (60.0, 8.0, 0.015)
    assert camera.distortion == Distortion(k1=-0.3, p2=0.01)
    assert camera.tilt_deg == (4.0, -6.0)
    assert camera.principal_point_px == (150.25, 128.5)
    assert camera.rotation == plain[2].rotation
    # the lens is aimed at the centre of the volume, and focused on it
    center = [scene_with().volume.center_mm]
    assert_allclose(camera.project(center)[0][0], (150.25, 128.5), rtol=0, atol=1e-9)
    assert camera.focus_mm == pytest.approx(plain[2].focus_mm, rel=1e-3)
    sharp = build_rig(scene_with(OWN | {"focus_mm": 400.0})).cameras[2]
    assert sharp.focus_mm == pytest.approx(400.0)


@pytest.mark.parametrize(
    ("each", "key"),
    [
        ([OWN | {"camera": "camera_04"}], "each.0.camera"),
        ([OWN, {"camera": "camera_02"}], "each.1.camera"),
        ([OWN | {"tilt_deg": [90.0, 0.0]}], "each.0.tilt_deg.0"),
        ([OWN | {"tilt_deg": [5.0]}], "each.0.tilt_deg"),
        ([OWN | {"pixel_mm": 0.0}], "each.0.pixel_mm"),
        ([OWN | {"rows": 100}], "each.0.rows"),
        ([{"f_number": 8.0}], "each.0.camera"),
        ([OWN | {"focus_mm": 55.0}], "focus_mm: camera_02"),
    ],
)
def test_what_cannot_be_is_refused(each: list[dict[str, Any]], key: str) -> None:
    with refused(f"test: cameras.{key}") as caught:
        build_rig(scene_with(*each), "test")
    assert "\n" not in str(caught.value)


def test_data_sets_keep_the_tilt(tmp_path: Path) -> None:
    made = sabench.generate(scene_with(OWN), tmp_path / "data", seed=1, backend="splat")
    assert sabench.open_dataset(made.root).setup.pinholes[2].tilt_deg == (4.0, -6.0)
    path = made.root / "cameras.json"
    values = json.loads(path.read_text(encoding="utf-8"))
    assert [("tilt_deg" in camera) for camera in values["cameras"]] == [False, False, True, False]
    values["cameras"][2]["tilt_deg"] = [0.0, 95.0]
    path.write_text(json.dumps(values), encoding="utf-8")
    with refused("cameras.json: cameras.2.tilt_deg.1"):
        read_cameras(made.root)


def test_nominal_tilts_are_off_by_the_scene_s_error() -> None:
    unknown = ("tilt", "principal_point", "k1")
    scene = scene_with(OWN, calibration={"tilt_deg": 0.5, "unknown": list(unknown)})
    true = build_rig(scene).cameras
    many = [nominal_cameras(scene, true, seed)[2] for seed in range(300)]
    errors = np.array([camera.tilt_deg for camera in many]) - true[2].tilt_deg
    assert scene.unknown == unknown
    assert_allclose(errors.std(axis=0), 0.5, rtol=0.15)
    assert_allclose(errors.mean(axis=0), 0.0, atol=0.12)
    assert all(camera.distortion == Distortion(p2=0.01) for camera in many)
    assert nominal_cameras(scene_with(OWN, calibration={}), true, 1) == true


def test_a_tilt_moves_projections_little_and_focus_much() -> None:
    """The use of a tilt: other points are sharp, at nearly the same pixels."""
    camera = build_rig(scene_with({"camera": "camera_00", "tilt_deg": [0.0, 5.0]})).cameras[0]
    points = np.random.default_rng(1).uniform([-4.5, -3.0, 28.0], [4.5, 3.0, 32.0], (50, 3))
    flat = replace(camera, tilt_deg=(0.0, 0.0))
    assert 0.01 < np.abs(camera.project(points)[0] - flat.project(points)[0]).max() < 3.0


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.3, -0.5, 1.0), (-1.0, 0.4, 2.0)])
def test_a_plane_in_focus_has_the_tilt_of_the_hinge_rule(
    normal: tuple[float, float, float],
) -> None:
    """The formula of docs/physics/imaging.md, in the lens's frame."""
    values = scene_with().to_dict()
    each = [{"camera": "camera_03", "tilt_deg": [1.0, 2.0]}]
    values["cameras"] |= {"focus_normal": normal, "each": each}
    del values["wall"]
    cameras = build_rig(parse_scene(values, "test")).cameras
    assert cameras[3].tilt_deg == (1.0, 2.0)
    for camera in cameras[:3]:
        x, y, z = np.asarray(camera.rotation) @ normal
        enlarged = camera.principal_distance_mm / camera.focus_mm
        about_x = np.arctan(y / z * enlarged)
        about_y = np.arctan(-np.cos(about_x) * x / z * enlarged)
        assert_allclose(camera.tilt_deg, np.rad2deg([about_x, about_y]), rtol=0, atol=2e-3)
