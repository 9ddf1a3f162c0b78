"""Visibility of points in cameras."""

from __future__ import annotations

from collections.abc import Sequence

from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F64


def any_in_view(cameras: Sequence[CameraModel], points_mm: F64) -> bool:
    """Check whether any of the points (n, 3) lies on any camera's image."""
    views = ((camera, *camera.project(points_mm)) for camera in cameras)
    return any((valid & camera.contains(pixels)).any() for camera, pixels, valid in views)
