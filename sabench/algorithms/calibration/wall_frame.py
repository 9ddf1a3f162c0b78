"""Frame of a wall, and similarities that bring points onto others."""

from __future__ import annotations

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import RigidMotion, fit_rigid_motion
from sabench.geometry.rotations import frame_of_normal
from sabench.utils.arrays import F64


def wall_frame(wall: Wall | None, cameras: tuple[Camera, ...], points_mm: F64) -> RigidMotion:
    """Find the motion from the world to the frame of a wall.

    There the outer face is Z = 0 and the normal +Z. Without a wall the plane lies between the
    cameras and the points; it then has no meaning.
    """
    if wall is not None:
        rotation = frame_of_normal(np.asarray(wall.normal, dtype=np.float64))
        point = np.asarray(wall.point_mm)
        return RigidMotion(rotation, -rotation @ point * np.array([0.0, 0.0, 1.0]))
    centers = np.array([camera.center_mm for camera in cameras])
    normal = np.mean([camera.rotation[2] for camera in cameras], axis=0)
    normal /= np.linalg.norm(normal)
    middle = ((centers @ normal).max() + np.nanmin(points_mm.reshape(-1, 3) @ normal)) / 2.0
    return RigidMotion(frame_of_normal(normal), np.array([0.0, 0.0, -middle]))


def fit_similarity(points: F64, targets: F64) -> F64:
    """Fit a similarity (4, 4) that brings points to targets.

    A homogeneous matrix of rotation, scale and shift. Points and targets are (n, 3); the fit is one
    of least squares.
    """
    motion = fit_rigid_motion(points, targets)
    rotated = (points - points.mean(axis=0)) @ motion.rotation.T
    scale = float(np.sum(rotated * (targets - targets.mean(axis=0))) / np.sum(rotated**2))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * motion.rotation
    matrix[:3, 3] = targets.mean(axis=0) - scale * motion.rotation @ points.mean(axis=0)
    return matrix
