"""Interface of all camera models."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sabench.geometry.refraction import AnyWall, Rays, trace_into_fluid, trace_to_points
from sabench.utils.arrays import F64, Bool

Vector = tuple[float, float, float]
Rotation = tuple[Vector, Vector, Vector]  # rows


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
    def center_mm(self) -> Vector:
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


class WalledPinhole(SensorCamera):
    """Part that pinholes share which look through a wall: lines of sight."""

    center_mm: Vector
    rotation: Rotation
    wall: AnyWall | None

    def ideal(self, pixels: npt.ArrayLike) -> tuple[F64, Bool]:
        """Convert pixels (n, 2) to ideal image coordinates (n, 2), x/z and y/z."""
        raise NotImplementedError(f"{type(self).__name__} must implement ideal()")

    def directions(self, pixels: npt.ArrayLike) -> tuple[F64, Bool]:
        """Compute unit world directions (n, 3) in the camera's medium of pixels (n, 2)."""
        ideal, valid = self.ideal(pixels)
        local = np.column_stack([ideal, np.ones(len(ideal))])
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return local @ np.asarray(self.rotation), valid

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return the rays in the fluid that pixels (n, 2) see.

        `valid` is false on total reflection, and where the lens shows nothing.
        """
        directions, valid = self.directions(pixels)
        rays = trace_into_fluid(self.wall, np.asarray(self.center_mm), directions)
        return Rays(rays.origins_mm, rays.directions, rays.valid & valid)

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Intersect lines of sight through points (n, 3) with the plane at `z_mm`.

        The points lie in the fluid. Returns (n, 2); NaN for points without a line of sight.
        """
        arriving = trace_to_points(self.wall, np.asarray(self.center_mm), points_mm).arriving
        return np.asarray(
            points_mm[:, :2] + arriving[:, :2] / arriving[:, 2:] * (z_mm - points_mm[:, 2:])
        )


def describe_cameras(cameras: Sequence[CameraModel]) -> str:
    """Say how many cameras there are, and how large their images are."""
    sizes = sorted({f"{one.columns} x {one.rows}" for one in cameras})
    return f"{len(cameras)} of {' and '.join(sizes)} px"


def any_in_view(cameras: Sequence[CameraModel], points_mm: F64) -> bool:
    """Check whether any of the points (n, 3) lies on any camera's image."""
    views = ((camera, *camera.project(points_mm)) for camera in cameras)
    return any((valid & camera.contains(pixels)).any() for camera, pixels, valid in views)
