"""Frame of a wall, and similarities that bring points onto others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import RigidMotion, fit_rigid_motion
from sabench.geometry.rotations import frame_of_normal
from sabench.utils.arrays import F64
from sabench.utils.errors import DeclinedError


def check_plane_wall(cameras: Sequence[Camera]) -> None:
    """Refuse cameras that are not behind one plane wall, or in plain air.

    Raises
    ------
    DeclinedError
        A cylinder, or cameras that look through different walls.
    """
    if not has_plane_wall(cameras):
        alike = len({camera.wall for camera in cameras}) == 1
        got = "a cylinder" if alike else "cameras behind different walls"
        raise DeclinedError(f"it needs one plane wall in front of all cameras, got {got}")


def has_plane_wall(cameras: Sequence[Camera]) -> bool:
    """Return whether all cameras are behind one plane wall, or all in plain air."""
    return common_plane(cameras) is not None or not any(camera.wall for camera in cameras)


def common_plane(cameras: Sequence[Camera]) -> Wall | None:
    """Return the plane wall of all cameras; None where there is no such wall."""
    wall = cameras[0].wall
    same = all(camera.wall == wall for camera in cameras)
    return wall if same and isinstance(wall, Wall) else None


def wall_frame(wall: Wall | None, cameras: tuple[Camera, ...], points_mm: F64) -> RigidMotion:
    """Find the motion from the world to the frame of a wall.

    There the outer face is Z = 0 and the normal +Z. Without a common plane wall the plane lies
    between the cameras and the points; it then has no meaning.
    """
    if wall is not None:
        rotation = frame_of_normal(np.asarray(wall.normal, dtype=np.float64))
        point = np.asarray(wall.point_mm)
        return RigidMotion(rotation, -rotation @ point * np.array([0.0, 0.0, 1.0]))
    centers = np.array([camera.center_mm for camera in cameras])
    normal = np.mean([camera.rotation[2] for camera in cameras], axis=0)
    length = np.linalg.norm(normal)  # 0 for cameras that face each other
    normal = normal / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
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
