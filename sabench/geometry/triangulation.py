"""Triangulation of points from their images in cameras of any model."""

from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F64

_STEPS = 5
DELTA_MM = 1e-3  # step for a projection's slope


def triangulate(cameras: Sequence[CameraModel], pixels: F64) -> F64:
    """Triangulate points (n, 3) from pixels (camera, n, 2) by least squares.

    Squares are of pixels. NaN where fewer than two cameras see one.

    Lines of sight are intersected first; then Gauss and Newton's steps lower the sum of squared
    reprojection errors.
    """
    points = intersect(cameras, pixels)
    for _ in range(_STEPS):
        step = _step(cameras, pixels, points)
        points = points + step
        if np.nanmax(np.abs(step), initial=0.0) < 1e-9:
            break
    return points


def intersect(cameras: Sequence[CameraModel], pixels: F64) -> F64:
    """Find points (n, 3) nearest to the lines of sight of pixels (camera, n, 2).

    NaN where fewer than two cameras see one.
    """
    count = pixels.shape[1]
    matrix, right, views = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros(count)
    for camera, camera_pixels in zip(cameras, pixels, strict=True):
        usable = np.isfinite(camera_pixels).all(axis=1)
        rays = camera.back_project(camera_pixels[usable])
        usable[usable] = rays.valid
        direction = rays.directions[rays.valid]
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        matrix[usable] += across
        right[usable] += np.einsum("nij,nj->ni", across, rays.origins_mm[rays.valid])
        views[usable] += 1.0
    points = np.full((count, 3), np.nan)
    enough = (views >= 2.0) & (np.abs(np.linalg.det(matrix)) > 1e-12)
    points[enough] = np.linalg.solve(matrix[enough], right[enough][:, :, None])[:, :, 0]
    return points


def _step(cameras: Sequence[CameraModel], pixels: F64, points: F64) -> F64:
    """Compute a Gauss-Newton step of every point; zero where it cannot be made."""
    matrix, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for camera, camera_pixels in zip(cameras, pixels, strict=True):
        here, valid = camera.project(points)
        ends = ((points + axis, points - axis) for axis in DELTA_MM * np.eye(3))
        moves = [camera.project(end)[0] - camera.project(start)[0] for end, start in ends]
        slope = np.stack([move / (2.0 * DELTA_MM) for move in moves], -1)
        good = valid & np.isfinite(camera_pixels).all(axis=1) & np.isfinite(slope).all(axis=(1, 2))
        matrix[good] += np.einsum("nki,nkj->nij", slope[good], slope[good])
        right[good] += np.einsum("nki,nk->ni", slope[good], camera_pixels[good] - here[good])
    step = np.zeros_like(points)
    enough = np.abs(np.linalg.det(matrix)) > 1e-12
    step[enough] = np.linalg.solve(matrix[enough], right[enough][:, :, None])[:, :, 0]
    return step
