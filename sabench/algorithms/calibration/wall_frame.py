"""Rigid motions: turns from small vectors, the frame of a wall, and the motion that brings points onto others."""

from __future__ import annotations

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall, wall_axes
from sabench.geometry.rigid_motion import RigidMotion, fit_rigid_motion
from sabench.utils.arrays import F64, triple


def wall_frame(wall: Wall | None, cameras: tuple[Camera, ...], points_mm: F64) -> RigidMotion:
    """From the world to the frame whose Z = 0 is the wall's outer face and whose Z axis is its normal.

    Without a wall the plane lies between the cameras and the points; it then has no meaning.
    """
    if wall is not None:
        turn = np.stack(wall_axes(wall))
        return RigidMotion(turn, -turn @ np.asarray(wall.point_mm) * np.array([0.0, 0.0, 1.0]))
    centers = np.array([camera.center_mm for camera in cameras])
    normal = np.mean([camera.rotation[2] for camera in cameras], axis=0)
    normal /= np.linalg.norm(normal)
    middle = ((centers @ normal).max() + np.nanmin(points_mm.reshape(-1, 3) @ normal)) / 2.0
    turn = np.stack(wall_axes(Wall(triple(normal * middle), triple(normal), 1.0, (), 1.0)))
    return RigidMotion(turn, np.array([0.0, 0.0, -middle]))


def fit_similarity(points: F64, targets: F64) -> F64:
    """The homogeneous matrix (4, 4) of the turn, scale and shift of points (n, 3) that bring them nearest to targets (n, 3)."""
    motion = fit_rigid_motion(points, targets)
    turned = (points - points.mean(axis=0)) @ motion.rotation.T
    scale = float(np.sum(turned * (targets - targets.mean(axis=0))) / np.sum(turned**2))
    matrix = np.eye(4)
    matrix[:3, :3] = scale * motion.rotation
    matrix[:3, 3] = targets.mean(axis=0) - scale * motion.rotation @ points.mean(axis=0)
    return matrix
