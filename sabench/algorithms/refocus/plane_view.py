"""Cameras that see planes of constant Z edge-on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid

_FLATTEST_DEGREES = 15.0  # between a line of sight and the planes


def find_edge_on(cameras: Sequence[CameraModel], grid: Grid) -> str | None:
    """Say which camera sees a grid's planes edge-on; None if none does.

    The angle is that of a distant camera which shortens directions in the plane as much, in the
    middle of the grid: the ratio of the singular values of pixels' derivatives by X and Y is its
    sine.
    """
    middle = np.array([(axis[0] + axis[-1]) / 2.0 for axis in grid.axes_mm])
    step = 0.5 * float(np.min(grid.voxel_mm))
    ends = middle + step * np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    for camera in cameras:
        pixels, valid = camera.project(ends)
        if not valid.all():
            continue  # what asks for light paths says so
        least, most = np.sort(np.linalg.svd(pixels[:2] - pixels[2:], compute_uv=False))
        angle = float(np.rad2deg(np.arcsin(min(least / max(most, 1e-300), 1.0))))
        if angle < _FLATTEST_DEGREES:
            return (
                f"it refocuses planes of constant Z, which {camera.name} sees edge-on, at "
                f"{angle:.0f} degrees (at least {_FLATTEST_DEGREES:.0f}): turn the world so that "
                "Z is the viewing direction"
            )
    return None
