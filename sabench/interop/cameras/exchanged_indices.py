"""Exchanged refractive indices of wall and fluid, recognised by known points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.central_camera import CentralCamera
from sabench.geometry.refraction import Wall
from sabench.interop.foreign_world import note
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_CLEARLY = 0.5  # largest ratio of residuals at which the exchanged indices are taken


def choose_indices(
    path: Path, cameras: Sequence[CameraModel], points_mm: F64, pixels: F64
) -> list[CameraModel]:
    """Exchange the indices of wall and fluid if points then fit twice as well.

    Parameters
    ----------
    points_mm : (n, 3) in the world of the files.
    pixels : (camera, n, 2); NaN where a camera does not see a point.

    Raises
    ------
    InputError
        Arrays of other shapes.
    """
    expected = (len(cameras), len(points_mm), 2)
    if np.shape(points_mm) != (len(points_mm), 3) or np.shape(pixels) != expected:
        raise InputError(
            f"{path}: points: expected (n, 3) and pixels {expected}, got {np.shape(points_mm)} and "
            f"{np.shape(pixels)}"
        )
    others = [_exchanged(camera) for camera in cameras]
    if all(other is camera for other, camera in zip(others, cameras, strict=True)):
        return list(cameras)
    as_read, exchanged = (_residual_px(group, points_mm, pixels) for group in (cameras, others))
    if exchanged <= _CLEARLY * as_read:
        note(
            f"{path}: the refractive indices of wall and fluid were exchanged: the points then fit "
            f"to {exchanged:.3g} px, and as in the file to {as_read:.3g} px"
        )
        return others
    note(
        f"{path}: the points fit to {as_read:.3g} px (to {exchanged:.3g} px with the indices of "
        "wall and fluid exchanged)"
    )
    return list(cameras)


def _exchanged(camera: CameraModel) -> CameraModel:
    """Exchange the indices of a camera's only layer and of the fluid."""
    if not isinstance(camera, Camera | CentralCamera):
        return camera
    wall = camera.wall
    if not isinstance(wall, Wall) or len(wall.layers) != 1:
        return camera
    layer = replace(wall.layers[0], index=wall.fluid_index)
    other = replace(wall, layers=(layer,), fluid_index=wall.layers[0].index)
    return replace(camera, wall=other)


def _residual_px(cameras: Sequence[CameraModel], points_mm: F64, pixels: F64) -> float:
    """Compute the root mean square reprojection error; infinite without a point."""
    pairs = zip(cameras, pixels, strict=True)
    miss = np.concatenate([camera.project(points_mm)[0] - own for camera, own in pairs])
    seen = miss[np.isfinite(miss).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum(seen**2, axis=1)))) if len(seen) else float("inf")
