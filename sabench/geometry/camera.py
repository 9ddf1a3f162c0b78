"""Pinhole cameras with radial-tangential distortion and a sensor at any tilt.

They look through a wall, or through air. `Camera.pixels_of` of paths by
`refraction.trace_to_points` is the reference of the projection; its copies, their reasons and the
tests that tie them to it: docs/developing/copies-of-the-projection.md.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import Rotation, Vector, WalledPinhole
from sabench.geometry.cylinder_wall import WallRecord
from sabench.geometry.lens import (
    UPRIGHT,
    Distortion,
    distort,
    from_sensor,
    onto_sensor,
    sensor_axes,
    undistort,
)
from sabench.geometry.refraction import Wall, trace_to_points
from sabench.geometry.rigid_motion import cross, frame_of_normal
from sabench.utils.arrays import F64, Bool, all_in_row, rows_of, triple
from sabench.utils.validation import TiltAngle

if TYPE_CHECKING:
    from sabench.geometry.projection_kernels import Media


@dataclass(frozen=True)
class Camera(WalledPinhole):
    """One camera of an array.

    Attributes
    ----------
    name : used in file names.
    rows, columns : image size, px.
    center_mm : pinhole, world frame.
    rotation : 3x3 as nested tuples, world to camera: the rows are the camera's X (right), Y (down)
        and Z (forward) axes in the world.
    principal_distance_mm : distance from the pinhole to the image plane.
    pixel_mm : pixel pitch.
    principal_point_px : (column, row) of the optical axis; (0, 0) is the CENTRE of the top-left
        pixel.
    distortion : radial-tangential coefficients.
    focal_length_mm, f_number : of the lens, for defocus and light gathering.
    wall : wall that the camera looks through; None for plain air.
    tilt_deg : of the sensor against the lens, see `sensor_tilt`; the axes above are the lens's, and
        the principal distance is along them.
    """

    name: str
    rows: int
    columns: int
    center_mm: Vector
    rotation: Rotation
    principal_distance_mm: float
    pixel_mm: float
    principal_point_px: tuple[float, float]
    distortion: Distortion
    focal_length_mm: float
    f_number: float
    wall: WallRecord | None = None
    tilt_deg: tuple[TiltAngle, TiltAngle] = UPRIGHT

    @property
    def focal_px(self) -> float:
        """Principal distance in pixels."""
        return self.principal_distance_mm / self.pixel_mm

    @property
    def aperture_radius_mm(self) -> float:
        """Radius of the entrance pupil."""
        return self.focal_length_mm / self.f_number / 2.0

    @property
    def focus_mm(self) -> float:
        """Distance in the camera's medium at which points are sharp.

        The thin lens's conjugate of the principal distance; it may be infinite. With a tilted
        sensor it is the distance along the optical axis.
        """
        inverse = 1.0 / self.focal_length_mm - 1.0 / self.principal_distance_mm
        return 1.0 / inverse if inverse else float("inf")

    def shifted(self, right_mm: float, down_mm: float) -> Camera:
        """Copy the camera with its pinhole moved in the plane of the lens.

        The new pinhole is a point of the aperture.
        """
        axes = np.asarray(self.rotation)
        center = np.asarray(self.center_mm) + right_mm * axes[0] + down_mm * axes[1]
        return replace(self, center_mm=triple(center))

    def upright(self) -> Camera:
        """Give the camera with an upright sensor that projects as this one does.

        Its optical axis is normal to the sensor. Other points are in focus.

        Raises ValueError: a tilted sensor behind a lens with distortion: there is none.
        """
        if self.tilt_deg == UPRIGHT:
            return self
        if self.distortion != Distortion():
            raise ValueError(
                f"camera {self.name}: expected no distortion next to a tilted sensor, got "
                f"{self.distortion}"
            )
        axes = sensor_axes(self.tilt_deg)
        turned = axes @ np.asarray(self.rotation)
        column, row = np.asarray(self.principal_point_px) - self.focal_px * axes[:2, 2]
        return replace(
            self,
            rotation=(triple(turned[0]), triple(turned[1]), triple(turned[2])),
            principal_distance_mm=self.principal_distance_mm * float(axes[2, 2]),
            principal_point_px=(float(column), float(row)),
            tilt_deg=UPRIGHT,
        )

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Also returns whether each point has a pixel. Not `valid`: points outside the fluid, behind
        the camera's image plane, or where distortion folds the image over. A valid pixel may lie
        outside the image: see `contains`.
        """
        points = rows_of(points_mm, 3, "points_mm")
        if self.wall is None:
            offset = points - np.asarray(self.center_mm)
            return self.pixels_of(offset, all_in_row(np.isfinite(offset)))
        outside = self.wall.depth_of(np.asarray(self.center_mm)) < 0.0
        if not (outside and isinstance(self.wall, Wall)):
            paths = trace_to_points(self.wall, np.asarray(self.center_mm), points)
            return self.pixels_of(paths.leaving, paths.valid)
        from sabench.geometry import projection_kernels  # numba is loaded at the first use

        x, y, z = np.ascontiguousarray(points.T)
        pixels = np.empty((2, len(points)))  # without distortion; NaN without a path
        try:
            frame, media, lens = _constants(self, self.wall)
        except TypeError:  # made by hand, of lists or arrays, which have no hash
            frame, media, lens = _constants.__wrapped__(self, self.wall)
        projection_kernels.project(x, y, z, self.center_mm, frame, media, lens, *pixels)
        pixels = np.ascontiguousarray(pixels.T)
        valid = np.asarray(np.isfinite(pixels[:, 0]) & np.isfinite(pixels[:, 1]))
        if self.distortion != Distortion() or self.tilt_deg != UPRIGHT:
            middle = np.asarray(self.principal_point_px)
            ideal = np.where(valid[:, None], (pixels - middle) / self.focal_px, 0.0)
            return self._on_sensor(ideal, valid)
        pixels[~valid] = np.nan
        return pixels, valid

    def pixels_of(self, leaving: F64, valid: Bool) -> tuple[F64, Bool]:
        """Project world directions (n, 3) that leave the pinhole to pixels (n, 2).

        They may have any length.
        """
        local = np.asarray(self.rotation) @ leaving.T
        valid = valid & (local[2] > 1e-9)
        return self._on_sensor((local[:2] / np.where(valid, local[2], 1.0)).T, valid)

    def _on_sensor(self, image: F64, valid: Bool) -> tuple[F64, Bool]:
        """Distort ideal image coordinates (n, 2) and take them to pixels (n, 2)."""
        if self.distortion != Distortion():
            image, one_to_one, _ = distort(self.distortion, image)
            valid = valid & one_to_one
        if self.tilt_deg != UPRIGHT:
            image, behind = onto_sensor(self.tilt_deg, image)
            valid = valid & behind
        pixels = np.ascontiguousarray(image * self.focal_px + np.asarray(self.principal_point_px))
        pixels[~valid] = np.nan
        return pixels, valid

    def ideal(self, pixels: npt.ArrayLike) -> tuple[F64, Bool]:
        """Undistort pixels (n, 2) to image coordinates (n, 2), x/z and y/z."""
        distorted = (
            rows_of(pixels, 2, "pixels") - np.asarray(self.principal_point_px)
        ) / self.focal_px
        if self.tilt_deg == UPRIGHT:
            return undistort(self.distortion, distorted)
        distorted, before = from_sensor(self.tilt_deg, distorted)
        ideal, valid = undistort(self.distortion, distorted)
        return ideal, valid & before

    def etendue(self) -> F64:
        """Compute the etendue that each pixel collects, mm^2 sr.

        It is the pupil's projected area times the pixel's solid angle in front of the lens; (rows,
        columns). It is 0 where the distorted lens shows nothing.
        """
        return _etendue(self)


@functools.lru_cache(maxsize=256)
def _constants(camera: Camera, wall: Wall) -> tuple[tuple[float, ...], Media, tuple[float, ...]]:
    from sabench.geometry import projection_kernels

    axes = frame_of_normal(np.asarray(wall.normal, dtype=np.float64))
    local = np.asarray(camera.rotation) @ axes.T
    local[:2] *= camera.focal_px
    lens = (*local.ravel().tolist(), *(float(v) for v in camera.principal_point_px))
    media = projection_kernels.media_of(wall, np.asarray(camera.center_mm))
    return tuple(axes.ravel().tolist()), media, lens


@functools.lru_cache(maxsize=32)
def _etendue(camera: Camera) -> F64:
    """Compute the etendue once for all frames of a camera."""
    column, row = np.arange(camera.columns), np.arange(camera.rows)
    middle, valid = _ideal_lattice(camera, column, row)
    sides, sides_valid = _ideal_lattice(camera, np.arange(camera.columns + 1) - 0.5, row)
    ends, ends_valid = _ideal_lattice(camera, column, np.arange(camera.rows + 1) - 0.5)
    valid &= sides_valid[:, 1:] & sides_valid[:, :-1] & ends_valid[1:] & ends_valid[:-1]
    across, along = sides[:, :, 1:] - sides[:, :, :-1], ends[:, 1:] - ends[:, :-1]
    area = np.abs(across[0] * along[1] - across[1] * along[0])
    square = 1.0 + (middle[0] ** 2 + middle[1] ** 2)
    out = np.asarray(np.pi * camera.aperture_radius_mm**2 * area / square**2)
    out[~valid] = 0.0
    out.flags.writeable = False
    return out


def _ideal_lattice(camera: Camera, column: npt.ArrayLike, row: npt.ArrayLike) -> tuple[F64, Bool]:
    """Return ideal coordinates (2, row, column), and whether the lens has any."""
    pixels = np.stack(np.meshgrid(column, row), axis=-1)
    ideal, valid = camera.ideal(pixels.reshape(-1, 2))
    shape = pixels.shape[:2]
    return np.ascontiguousarray(ideal.T).reshape(2, *shape), valid.reshape(shape)


def aimed_rotation(forward: F64, down: npt.ArrayLike = (0.0, 1.0, 0.0)) -> Rotation:
    """Make the world-to-camera rotation with Z axis `forward` and Y axis near `down`."""
    z = forward / np.linalg.norm(forward)
    x = cross(np.asarray(down, dtype=np.float64), z)
    if np.linalg.norm(x) < 1e-9:  # along `down`: any right-hand side will do, so the world's X
        x = cross(cross(z, np.array([1.0, 0.0, 0.0])), z)
    x = x / np.linalg.norm(x)
    return triple(x), triple(cross(z, x)), triple(z)


def aim(camera: Camera, target_mm: npt.ArrayLike, down: npt.ArrayLike = (0.0, 1.0, 0.0)) -> Camera:
    """Rotate a camera so that light from `target_mm` runs along its optical axis.

    Refraction is included. Its Y axis is as near to `down` as it can be.
    """
    target = np.asarray(target_mm, dtype=np.float64)[None]
    paths = trace_to_points(camera.wall, np.asarray(camera.center_mm), target)
    if not paths.valid[0]:
        raise ValueError(
            f"camera {camera.name}: no light path to its aim point {target[0].tolist()}"
        )
    return replace(camera, rotation=aimed_rotation(paths.leaving[0], down))
