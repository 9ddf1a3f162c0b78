"""Volumes that all cameras see."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.geometry.camera import Camera
from sabench.geometry.common_view import (
    SIDE,
    border_pixels,
    grid_of_box,
    lattice_of,
    light_paths,
    pixel_size_mm,
    propose_box,
    seen_by_all,
    share_in_view,
)
from sabench.geometry.polynomial_cameras import fit_soloff
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused
from tests.helpers.small_particles import rotate_cameras


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", ["quick", "cylinder-tank", "particle-tracking-air"])
def test_all_cameras_see_the_proposed_box(name: str) -> None:
    rig = build_rig(load_scene(name), name)
    low, high = propose_box(rig.cameras)
    grid = grid_of_box(low, high, pixel_size_mm(rig.cameras, 0.5 * (low + high)))
    assert seen_by_all(rig.cameras, lattice_of(grid)).all()
    assert ((high - low) > 2.0).all()


def test_the_box_is_as_large_as_cameras_see() -> None:
    cameras = build_rig(load_scene("quick"), "quick").cameras
    low, high = propose_box(cameras)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    for axis in np.eye(3):
        for sign in (-1.0, 1.0):
            face = middle + half * (1.0 + 0.15 * axis) * (1.0 - axis + sign * axis)
            assert not seen_by_all(cameras, face[None]).all() or np.abs(face - middle).max() > 5.0


def test_a_pixel_is_as_large_as_optics_make_it() -> None:
    camera = build_rig(load_scene("particle-tracking-air"), "air").cameras[0]
    point = np.array([0.0, 0.0, 30.0])
    distance = np.linalg.norm(point - np.asarray(camera.center_mm))
    expected = camera.pixel_mm * distance / camera.principal_distance_mm
    assert pixel_size_mm([camera], point) == pytest.approx(expected, rel=1e-3)


def test_fitted_cameras_see_no_further_than_their_fit() -> None:
    exact = build_rig(load_scene("quick"), "quick").cameras
    points = np.random.default_rng(2).uniform([-3, -2, 28], [3, 2, 32], (200, 3))
    fitted = [
        fit_soloff(one.name, one.rows, one.columns, points, one.project(points)[0]) for one in exact
    ]
    low, high = propose_box(fitted)
    assert (low > [-3.01, -2.01, 27.9]).all()
    assert (high < [3.01, 2.01, 32.1]).all()


def test_lines_of_sight_must_meet() -> None:
    camera = build_rig(load_scene("particle-tracking-air"), "air").cameras[0]
    with refused():
        propose_box([camera])
    with refused("x0", "x1"):
        grid_of_box(np.ones(3), np.zeros(3), 0.1)
    assert share_in_view(camera, grid_of_box(np.full(3, 1e3), np.full(3, 1.1e3), 1.0))[1] == 0.0


def test_the_box_turns_with_the_rig() -> None:
    cameras = build_rig(load_scene("quick"), "quick").cameras
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    plain, turned = propose_box(cameras), propose_box(rotate_cameras(cameras, turn))
    for one, other in zip(plain, turned, strict=True):
        assert_allclose(turn @ one, other, atol=1e-6)


def paths_of(camera: Camera, scene: str) -> F64:
    return light_paths(camera, border_pixels(camera), *build_rig(load_scene(scene)).grid.box_mm)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["quick", "cylinder-tank", "two-faces", "particle-tracking-air"])
def test_ends_of_paths_are_imaged_on_the_border(scene: str) -> None:
    for camera in build_rig(load_scene(scene)).cameras:
        paths = paths_of(camera, scene)
        assert np.isfinite(paths).all()
        pixels, valid = camera.project(paths[:, -1])
        assert valid.all()
        assert np.abs(pixels - border_pixels(camera)).max() < 1e-4


def test_paths_bend_on_the_faces_of_the_wall_by_snells_law() -> None:
    camera: Any = build_rig(load_scene("quick")).cameras[0]
    paths, wall = paths_of(camera, "quick"), camera.wall
    for corner, depth in zip(range(1, 3), wall.interface_depths_mm, strict=True):
        assert wall.depth_of(paths[:, corner]) == pytest.approx(depth, abs=1e-9)
    steps = np.diff(paths, axis=1)
    directions = steps / np.linalg.norm(steps, axis=2, keepdims=True)
    sines = np.linalg.norm(np.cross(directions, np.asarray(wall.normal)), axis=2)
    assert np.ptp(sines * wall.indices, axis=1).max() < 1e-9
    assert sines[:, 0].min() > 0.1  # they do bend


def test_paths_cross_both_faces_of_a_cylinder() -> None:
    camera: Any = build_rig(load_scene("cylinder-tank")).cameras[1]
    paths, wall = paths_of(camera, "cylinder-tank"), camera.wall
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
