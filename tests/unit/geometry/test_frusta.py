"""Frusta are the light paths of the cameras' own model."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.geometry.common_view import SIDE, border_pixels, light_paths
from sabench.geometry.refraction import Wall
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64


def paths_of(camera: Camera, scene: str) -> F64:
    return light_paths(camera, border_pixels(camera), *build_rig(load_scene(scene)).grid.box_mm)


@pytest.mark.parametrize("scene", ["quick", "cylinder-tank", "two-faces", "particle-tracking-air"])
def test_ends_of_paths_are_imaged_on_the_border(scene: str) -> None:
    for camera in build_rig(load_scene(scene)).cameras:
        paths = paths_of(camera, scene)
        assert np.isfinite(paths).all()
        pixels, valid = camera.project(paths[:, -1])
        assert valid.all()
        assert np.abs(pixels - border_pixels(camera)).max() < 1e-4


def test_paths_bend_on_the_faces_of_the_wall_by_snells_law() -> None:
    camera = build_rig(load_scene("quick")).cameras[0]
    paths, wall = paths_of(camera, "quick"), camera.wall
    assert isinstance(wall, Wall)
    for corner, depth in zip(range(1, 3), wall.interface_depths_mm, strict=True):
        assert wall.depth_of(paths[:, corner]) == pytest.approx(depth, abs=1e-9)
    steps = np.diff(paths, axis=1)
    directions = steps / np.linalg.norm(steps, axis=2, keepdims=True)
    sines = np.linalg.norm(np.cross(directions, np.asarray(wall.normal)), axis=2)
    refracted = sines * wall.indices
    assert np.ptp(refracted, axis=1).max() < 1e-9
    assert sines[:, 0].min() > 0.1  # they do bend


def test_paths_cross_both_faces_of_a_cylinder() -> None:
    camera = build_rig(load_scene("cylinder-tank")).cameras[1]
    paths, wall = paths_of(camera, "cylinder-tank"), camera.wall
    assert wall is not None
    assert np.abs(wall.depth_of(paths[:, 1])).max() < 1e-6
    assert wall.depth_of(paths[:, 2]) == pytest.approx(wall.thickness_mm, abs=1e-6)


def test_paths_in_air_are_straight_and_end_behind_the_volume() -> None:
    rig = build_rig(load_scene("particle-tracking-air"))
    camera, (low, high) = rig.cameras[0], rig.grid.box_mm
    paths = paths_of(camera, "particle-tracking-air")
    assert paths.shape == (4 * SIDE, 2, 3)
    assert paths[:, 0] == pytest.approx(np.tile(camera.center_mm, (4 * SIDE, 1)))
    middle = camera.back_project(np.array([[camera.columns - 1, camera.rows - 1]]) / 2.0)
    axis = middle.directions[0]
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    assert paths[:, 1] @ axis == pytest.approx(float((corners @ axis).max()))


def test_pixels_without_a_path_are_left_out() -> None:
    camera = build_rig(load_scene("quick")).cameras[0]
    beyond = np.array([[0.0, 0.0], [1e9, 0.0]])
    paths = light_paths(camera, beyond, *build_rig(load_scene("quick")).grid.box_mm)
    assert np.isfinite(paths[0]).all()
    assert np.isnan(paths[1]).all()
