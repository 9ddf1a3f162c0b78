"""Cameras that see no common part of a grid, or not all of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid

_FEWEST = 3  # cameras: two lines of sight meet by chance too often
_NODES, _INSIDE = 17, 0.98  # of the lattice along each axis, and its edge over the grid's


def find_fault(cameras: Sequence[CameraModel], grid: Grid) -> str | None:
    """Say why particles cannot be looked for with these cameras; None if they can."""
    if len(cameras) < _FEWEST:
        return "it needs three cameras"
    low, voxel = np.asarray(grid.low_mm), np.asarray(grid.voxel_mm)
    shares = 0.5 + _INSIDE * (np.arange(_NODES) / (_NODES - 1) - 0.5)
    lattice = np.stack(np.meshgrid(shares, shares, shares), axis=-1).reshape(-1, 3)
    points = low + voxel * (np.array(grid.shape[::-1]) - 1) * lattice
    count = np.zeros(len(points), dtype=np.int64)
    for camera in cameras:
        pixels, valid = camera.project(points)
        if not valid.all():
            return f"it needs a light path from all of the grid to {camera.name}"
        count += camera.contains(pixels)
    if count.max() < _FEWEST:
        return f"it needs three cameras that see the same part of the grid, got {count.max()}"
    return None
