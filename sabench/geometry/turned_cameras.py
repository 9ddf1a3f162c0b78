"""Cameras and grids in axes other than the world's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.utils.arrays import F64, triple


def viewing_axes(cameras: Sequence[Camera]) -> F64:
    """Choose the world's axes (3, 3) as x, y and z of the cameras, one a row.

    z is the axis along which they look, x of the other two that along which columns of their images
    grow, both on the average; x, y and z are right-handed. An array that looks along +Z and is
    upright keeps the world's axes.
    """
    means = np.mean([camera.rotation for camera in cameras], axis=0)
    z = int(np.argmax(np.abs(means[2])))
    x = int(np.argmax(np.where(np.arange(3) == z, -1.0, np.abs(means[0]))))
    axes = np.zeros((3, 3))
    axes[2, z] = 1.0 if means[2, z] >= 0.0 else -1.0
    axes[0, x] = 1.0 if means[0, x] >= 0.0 else -1.0
    axes[1] = np.cross(axes[2], axes[0])
    return axes


def turn_camera(camera: Camera, axes: F64) -> Camera:
    """Rewrite a camera and its wall for coordinates along axes (3, 3), one a row."""
    x, y, z = np.asarray(camera.rotation) @ axes.T
    wall = camera.wall
    keys = ("point_mm", "normal") if isinstance(wall, Wall) else ("axis_point_mm", "axis")
    turned: dict[str, Any] = {}
    if wall is not None:
        turned = {key: triple(axes @ np.asarray(getattr(wall, key))) for key in keys}
    return replace(
        camera,
        center_mm=triple(axes @ np.asarray(camera.center_mm)),
        rotation=(triple(x), triple(y), triple(z)),
        wall=None if wall is None else replace(wall, **turned),
    )


def turn_grid(grid: Grid, axes: F64) -> Grid:
    """Rewrite a grid for coordinates along axes (3, 3) as of `viewing_axes`."""
    order = np.abs(axes).argmax(axis=1)
    ends = np.array([(along[0], along[-1]) for along in grid.axes_mm])[order]
    low = (ends * axes.sum(axis=1)[:, None]).min(axis=1)
    x, y, z = (grid.shape[::-1][k] for k in order)
    voxel = np.asarray(grid.voxel_mm)[order]
    crop = [grid.crop[k] for k in order]
    return Grid(triple(low), triple(voxel), (z, y, x), (crop[0], crop[1], crop[2]))
