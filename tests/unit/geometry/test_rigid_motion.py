"""Rigid motions, and rigs that are turned."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sabench.algorithms.bubbles.search import turn_camera, turn_grid, viewing_axes
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import (
    RigidMotion,
    fit_lateral_motion,
    fit_rigid_motion,
    rotation_matrices,
)
from sabench.scenes import build_rig, load_scene
from sabench.utils.arrays import F64, triple

Fit = Callable[[F64, F64], RigidMotion]


@pytest.mark.parametrize("fit", [fit_rigid_motion, fit_lateral_motion])
@pytest.mark.parametrize("far_mm", [0.0, 1e7])
def test_a_motion_is_recovered_also_far_from_the_origin(fit: Fit, far_mm: float) -> None:
    """At 10 km doubles are 2e-9 mm apart; both sets are centred, so that no more is lost."""
    turn = np.array([0.3, -0.2, 0.9]) if fit is fit_rigid_motion else np.array([0.0, 0.0, 0.9])
    motion = RigidMotion(rotation_matrices(turn), np.array([5.0, -7.0, 0.0]))
    near = np.random.default_rng(2).uniform(-20.0, 20.0, (12, 3))
    points = near + far_mm * np.array([-0.3, 0.9, 0.0])
    targets = motion(near) + far_mm * np.array([1.0, -0.7, 0.0])
    found = fit(points, targets)
    assert_allclose(found.rotation, motion.rotation, atol=1e-9 if far_mm else 1e-13)
    assert_allclose(found(points), targets, rtol=0.0, atol=1e-7)


def axis_rotations() -> list[F64]:
    """All 24 rotations of axes onto axes."""
    made = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0.0:
                made.append(matrix)
    return made


def shifted(camera: Camera, shift: F64) -> Camera:
    wall: Any = camera.wall
    key = "point_mm" if isinstance(wall, Wall) else "axis_point_mm"
    moved = replace(wall, **{key: triple(shift + getattr(wall, key))})
    return replace(camera, center_mm=triple(shift + camera.center_mm), wall=moved)


@pytest.mark.parametrize("scene", ["quick", "cylinder-tank", "two-faces"])
def test_turned_cameras_and_walls_see_the_same(scene: str) -> None:
    cameras = build_rig(load_scene(scene)).cameras
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (30, 3))
    shift = np.array([300.0, -200.0, 70.0])
    for camera in cameras[:2]:
        moved = shifted(camera, shift).project(points + shift)[0]
        assert_allclose(moved, camera.project(points)[0], rtol=0.0, atol=1e-7)
    for axes in [*axis_rotations(), *Rotation.random(5, random_state=9).as_matrix()]:
        for camera in cameras[:2]:
            turned = turn_camera(camera, axes)
            expected, seen = camera.project(points)
            pixels, again = turned.project(points @ axes.T)
            assert_array_equal(seen, again)
            assert_allclose(pixels[seen], expected[seen], rtol=0.0, atol=1e-7)


def test_axes_follow_the_view() -> None:
    cameras = build_rig(load_scene("quick")).cameras
    assert_array_equal(viewing_axes(cameras), np.eye(3))
    for axes in axis_rotations():
        assert_array_equal(viewing_axes([turn_camera(camera, axes) for camera in cameras]), axes.T)


def test_turned_grids_hold_the_same_voxels() -> None:
    grid = Grid((1.0, -2.0, 3.0), (0.5, 0.25, 1.0), (4, 6, 5), (1, 2, 0))
    corners = np.stack(np.meshgrid(*grid.axes_mm, indexing="ij"), axis=-1).reshape(-1, 3)
    for axes in axis_rotations():
        turned = turn_grid(grid, axes)
        there = np.stack(np.meshgrid(*turned.axes_mm, indexing="ij"), axis=-1).reshape(-1, 3)
        own, same = ({*map(tuple, np.round(one, 9) + 0.0)} for one in (corners, there @ axes))
        assert own == same
        assert sorted(turned.crop) == sorted(grid.crop)
