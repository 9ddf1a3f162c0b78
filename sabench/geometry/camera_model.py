"""Interface of all camera models."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sabench.geometry.refraction import Rays
from sabench.utils.arrays import F64, Bool


class CameraModel(Protocol):
    """Map of points to pixels and of pixels to lines of sight.

    `Camera` is one, `Projective` and the models of `polynomial_cameras` are others.
    """

    @property
    def name(self) -> str:
        """Used in file names."""

    @property
    def rows(self) -> int:
        """Image height, px."""

    @property
    def columns(self) -> int:
        """Image width, px."""

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Also returns whether each point has a pixel.
        """

    @property
    def center_mm(self) -> tuple[float, float, float]:
        """Position of the camera, approximate if the model does not define one."""

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Intersect lines of sight through points (n, 3) with the plane at `z_mm`.

        The points lie in the fluid. Returns (n, 2); NaN for points without a line of sight.
        """

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return the lines of sight of pixels (n, 2) in the fluid."""

    def contains(self, pixels: F64, margin_px: float = 0.0) -> Bool:
        """Mark pixels (n, 2) on the sensor, or at most `margin_px` outside."""


class SensorCamera:
    """Part that all camera models share: their sensor."""

    def contains(self: CameraModel, pixels: F64, margin_px: float = 0.0) -> Bool:
        """Mark pixels (n, 2) on the sensor, or at most `margin_px` outside.

        The border belongs to it above and to the left only.
        """
        low = -0.5 - margin_px
        column, row = pixels[:, 0], pixels[:, 1]
        with np.errstate(invalid="ignore"):
            inside = (column >= low) & (row >= low) & (row < self.rows + margin_px - 0.5)
            return np.asarray(inside & (column < self.columns + margin_px - 0.5))


def any_in_view(cameras: Sequence[CameraModel], points_mm: F64) -> bool:
    """Check whether any of the points (n, 3) lies on any camera's image."""
    views = ((camera, *camera.project(points_mm)) for camera in cameras)
    return any((valid & camera.contains(pixels)).any() for camera, pixels, valid in views)
