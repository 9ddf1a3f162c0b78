"""Frusta of cameras: light paths of an image's border, through the wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.refraction import Rays
from sabench.utils.arrays import F64

SIDE = 6  # paths along each side of an image
_STEEPEST = 0.05  # cosine to the middle path below which a path is left out


def border_pixels(camera: CameraModel) -> F64:
    """List pixels (4 SIDE, 2) along the image's edge, each corner first of its side."""
    low, right, down = -0.5, camera.columns - 0.5, camera.rows - 0.5
    corners = np.array([[low, low], [right, low], [right, down], [low, down]])
    share = np.arange(SIDE)[:, None] / SIDE
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return np.concatenate([start + share * (end - start) for start, end in sides])


def light_paths(camera: CameraModel, pixels: F64, low_mm: F64, high_mm: F64) -> F64:
    """Follow the light paths of pixels (n, 2) from the camera through a box.

    Parameters
    ----------
    low_mm, high_mm : (3,) corners of the box. Paths end on the plane behind it that is at right
        angles to the path of the image's middle.

    Returns
    -------
    Points (n, corners, 3) where paths begin, bend and end: the pinhole, all faces of the wall and
    the end. A camera without a pinhole has a point in front of the box in place of the faces. NaN
    for pixels without a path.
    """
    middle = np.array([[(camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0]])
    axis = camera.back_project(middle).directions[0]
    steps = np.stack(np.meshgrid(*np.stack([low_mm, high_mm], axis=1)), axis=-1).reshape(-1, 3)
    depths = steps @ axis
    rays = camera.back_project(pixels)
    start = np.broadcast_to(np.asarray(camera.center_mm), rays.origins_mm.shape)
    if isinstance(camera, Camera):
        between = _faces(camera, pixels)
    else:
        between = [_reach(rays, axis, float(depths.min()))]
    paths = np.stack([start, *between, _reach(rays, axis, float(depths.max()))], axis=1)
    paths[~(rays.valid & np.isfinite(paths).all(axis=(1, 2)))] = np.nan
    return paths


def _faces(camera: Camera, pixels: F64) -> list[F64]:
    """Find where light crosses each face of the wall: (n, 3) each."""
    if camera.wall is None:
        return []
    directions, _ = camera.directions(pixels)
    center = np.asarray(camera.center_mm)
    return [
        replace(camera.wall, layers=camera.wall.layers[:count]).rays(center, directions).origins_mm
        for count in range(len(camera.wall.layers) + 1)
    ]


def _reach(rays: Rays, axis: F64, depth_mm: float) -> F64:
    """Follow rays to the plane at a depth along an axis: (n, 3)."""
    ahead = rays.directions @ axis
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = np.where(ahead > _STEEPEST, (depth_mm - rays.origins_mm @ axis) / ahead, np.nan)
    return np.asarray(rays.origins_mm + steps[:, None] * rays.directions)
