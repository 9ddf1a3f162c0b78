"""Motions of all cameras and points together that walls of any shape do not show."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.calibration.parameters import Frame
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import RigidMotion
from sabench.geometry.rotations import rotation_matrices
from sabench.utils.arrays import F64

_SAME = 1e-6  # part of a unit vector along a wall's normal below which a shift is along the wall


def fit_free_motion(frame: Frame, points: F64, targets: F64) -> RigidMotion:
    """Fit the motion of points (n, 3) to targets, in a frame, that no image shows.

    A cylinder allows a rotation about its axis and a shift along it, several plane walls a shift
    along all of them, other walls nothing.
    """
    walls = {camera.wall for camera in frame.cameras}
    (first, *others) = walls
    if isinstance(first, CylinderWall) and not others:
        return _about_axis(first, frame.motion, points, targets)
    planes = [wall for wall in walls if isinstance(wall, Wall)]
    if len(planes) < len(walls):
        return RigidMotion(np.eye(3), np.zeros(3))
    _, values, right = np.linalg.svd(np.array([wall.normal for wall in planes]))
    along = right[np.append(values, np.zeros(3))[:3] < _SAME] @ frame.motion.rotation.T
    return RigidMotion(np.eye(3), along.T @ along @ (targets - points).mean(axis=0))


def _about_axis(wall: CylinderWall, motion: RigidMotion, points: F64, targets: F64) -> RigidMotion:
    axis, point = motion.rotation @ np.asarray(wall.axis), motion(np.asarray(wall.axis_point_mm))
    one, other = points - point, targets - point
    crossed = np.sum(np.cross(one, other) @ axis)
    aligned = np.sum(one * other) - np.sum((one @ axis) * (other @ axis))
    rotation = rotation_matrices(np.arctan2(crossed, aligned) * axis)
    shift = np.mean((other - one) @ axis) * axis
    return RigidMotion(rotation, point - rotation @ point + shift)
