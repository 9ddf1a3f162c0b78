"""Pinhole cameras with radial-tangential distortion and a sensor at any tilt.

They look through a wall, or through air. `Camera.pixels_of` of paths by
`refraction.trace_to_points` is the reference of the projection; its copies, their reasons and the
tests that tie them to it: docs/developing/copies-of-the-projection.md.

`project`, one of these copies, projects many points in vector registers. Points come as separate
x, y and z, block by block, and no loop over points branches. The path's unknown is q = t / R, the
tangent in the rarest medium (as in `refraction`) over the lateral distance: only R^2 is needed, and
the axis is no special case. Halley's step from the paraxial path takes one square root and one
division per medium, as Newton's does, and triples the right digits. A block is finished when its
last step was so small that the next one would be lost in rounding. Where that takes too long
(grazing rays in thin rare layers), the block starts again with Newton's steps, which converge to
the root for any indices.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import SensorCamera
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
from sabench.geometry.refraction import Rays, Wall, trace_into_fluid, trace_to_points
from sabench.geometry.rigid_motion import cross, frame_of_normal
from sabench.utils.arrays import F64, Bool, all_in_row, rows_of, triple
from sabench.utils.compiled import numba
from sabench.utils.validation import TiltAngle

_BLOCK = 256
_HALLEY, _NEWTON = 6, 100
# relative change after which Halley's next would be below rounding; Newton's is asked for the
# square root of rounding
_SMALL = 1e-5
_SMALLER = 1e-8

Media = tuple[float, tuple[tuple[float, float], ...], float, float | None, float]


def media_of(wall: Wall, center_mm: F64) -> Media:
    """Collect what `project` needs of a wall in front of a pinhole (3,)."""
    ratios = (wall.indices / wall.indices.min()) ** 2
    before = -float(wall.depth_of(center_mm))
    depths = (before, *(float(layer.thickness_mm) for layer in wall.layers))
    constant = [(float(r), depth) for r, depth in zip(ratios[:-1], depths, strict=True)]
    rare = float(sum(depth for ratio, depth in constant if ratio == 1.0))  # 0 would be another type
    # numba cannot go through an empty tuple
    others = tuple(pair for pair in constant if pair[0] != 1.0) or ((1.0, 0.0),)
    first = float(ratios[0]) if ratios[0] > 1.0 else None
    return rare, others, float(ratios[-1]), first, before + wall.thickness_mm


@numba.njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _step(
    slope: Any, square: Any, deep: Any, size: int, rare: float, others: Any, fluid: float
) -> int:
    """Apply one of Halley's steps to a block and count the unknowns that still moved."""
    moving = 0
    for i in range(size):
        q = slope[i]
        t2 = q * q * square[i]
        inverse = 1.0 / math.sqrt(fluid + (fluid - 1.0) * t2)
        part = deep[i] * inverse
        value, gain = rare + part, part * inverse * inverse * fluid
        bow = gain * inverse * inverse * (fluid - 1.0)
        gain += rare
        for ratio, depth in others:
            inverse = 1.0 / math.sqrt(ratio + (ratio - 1.0) * t2)
            part = depth * inverse
            value += part
            part *= inverse * inverse * ratio
            gain += part
            bow += part * inverse * inverse * (ratio - 1.0)
        miss = 1.0 - value * q
        change = 2.0 * miss * gain / (2.0 * gain * gain - 3.0 * miss * bow * q * square[i])
        slope[i] = q + change
        moving += abs(change) > _SMALL * abs(q)
    return moving


@numba.njit(cache=True, error_model="numpy")
def _climb(
    slope: Any, square: Any, deep: Any, size: int, rare: float, others: Any, fluid: float
) -> None:
    for _ in range(_NEWTON):
        moving = 0
        for i in range(size):
            q = slope[i]
            t2 = q * q * square[i]
            inverse = 1.0 / math.sqrt(fluid + (fluid - 1.0) * t2)
            value, gain = rare + deep[i] * inverse, rare + deep[i] * inverse**3 * fluid
            for ratio, depth in others:
                inverse = 1.0 / math.sqrt(ratio + (ratio - 1.0) * t2)
                value += depth * inverse
                gain += depth * inverse**3 * ratio
            change = (1.0 - value * q) / gain
            slope[i] = q + change
            moving += abs(change) > _SMALLER * abs(q)
        if moving == 0:
            break


@numba.njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _paraxial(deep: Any, size: int, rare: float, others: Any, fluid: float, slope: Any) -> None:
    constant = rare
    for ratio, depth in others:
        constant += depth / math.sqrt(ratio)
    scale = 1.0 / math.sqrt(fluid)
    for i in range(size):
        slope[i] = 1.0 / (constant + deep[i] * scale)


@numba.njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _tangents(slope: Any, square: Any, size: int, first: Any) -> None:
    """Convert q to the tangent in the cameras' medium, given the lateral distance.

    It is returned unchanged where that medium is the rarest.
    """
    if first is not None:
        for i in range(size):
            slope[i] /= math.sqrt(first + (first - 1.0) * slope[i] * slope[i] * square[i])


@numba.njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def project(
    x: Any, y: Any, z: Any, center: Any, frame: Any, media: Any, lens: Any, column: Any, row: Any
) -> None:
    """Compute ideal pixels of points through a wall.

    NaN for points that are not in the fluid or behind the camera.

    Parameters
    ----------
    x, y, z : (n,) world points.
    center : the pinhole, as three numbers; it must be in front of the wall.
    frame : nine numbers: two unit vectors along the wall and its normal, world frame.
    media : as `media_of` gives them.
    lens : nine numbers, the camera's rotation from that frame with its first two rows times the
        focal length, and the principal point.
    column, row : (n,) the result.
    """
    rare, others, fluid, first, gap = media
    cx, cy, cz = center
    ax, ay, az, bx, by, bz, nx, ny, nz = frame
    m00, m01, m02, m10, m11, m12, m20, m21, m22, pu, pv = lens
    across, down, deep, square, slope = (
        np.empty(_BLOCK),
        np.empty(_BLOCK),
        np.empty(_BLOCK),
        np.empty(_BLOCK),
        np.empty(_BLOCK),
    )
    for start in range(0, len(x), _BLOCK):
        size = min(_BLOCK, len(x) - start)
        for i in range(size):
            px, py, pz = x[start + i] - cx, y[start + i] - cy, z[start + i] - cz
            a, b = px * ax + py * ay + pz * az, px * bx + py * by + pz * bz
            across[i], down[i], deep[i] = a, b, px * nx + py * ny + pz * nz - gap
            square[i] = a * a + b * b
        _paraxial(deep, size, rare, others, fluid, slope)
        moving = 1
        for _ in range(_HALLEY):
            moving = _step(slope, square, deep, size, rare, others, fluid)
            if moving == 0:
                break
        if moving != 0:
            _paraxial(deep, size, rare, others, fluid, slope)
            _climb(slope, square, deep, size, rare, others, fluid)
        _tangents(slope, square, size, first)
        for i in range(size):
            a, b = across[i] * slope[i], down[i] * slope[i]
            w = m20 * a + m21 * b + m22
            good = 1.0 / w if deep[i] > 0.0 and w > 1e-9 else math.nan
            column[start + i] = (m00 * a + m01 * b + m02) * good + pu
            row[start + i] = (m10 * a + m11 * b + m12) * good + pv


@dataclass(frozen=True)
class Camera(SensorCamera):
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
    center_mm: tuple[float, float, float]
    rotation: tuple[
        tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]
    ]
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
        """Distance of sharp points in the camera's medium.

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

        Raises
        ------
        ValueError
            A tilted sensor behind a lens with distortion: there is none.
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

        x, y, z = np.ascontiguousarray(points.T)
        pixels = np.empty((2, len(points)))  # without distortion; NaN without a path
        try:
            frame, media, lens = _constants(self, self.wall)
        except TypeError:  # made by hand, of lists or arrays, which have no hash
            frame, media, lens = _constants.__wrapped__(self, self.wall)
        project(x, y, z, self.center_mm, frame, media, lens, *pixels)
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

    def directions(self, pixels: npt.ArrayLike) -> tuple[F64, Bool]:
        """Compute unit world directions (n, 3) in the camera's medium of pixels (n, 2).

        Pixels are (column, row).
        """
        ideal, valid = self.ideal(pixels)
        local = np.column_stack([ideal, np.ones(len(ideal))])
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return local @ np.asarray(self.rotation), valid

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

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return the rays in the fluid that pixels (n, 2) see.

        `valid` is false on total reflection.
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

    def etendue(self) -> F64:
        """Compute the etendue that each pixel collects, mm^2 sr.

        It is the pupil's projected area times the pixel's solid angle in front of the lens; (rows,
        columns). It is 0 where the distorted lens shows nothing.
        """
        return _etendue(self)


@functools.lru_cache(maxsize=256)
def _constants(camera: Camera, wall: Wall) -> tuple[tuple[float, ...], Media, tuple[float, ...]]:

    axes = frame_of_normal(np.asarray(wall.normal, dtype=np.float64))
    local = np.asarray(camera.rotation) @ axes.T
    local[:2] *= camera.focal_px
    lens = (*local.ravel().tolist(), *(float(v) for v in camera.principal_point_px))
    media = media_of(wall, np.asarray(camera.center_mm))
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


def aimed_rotation(
    forward: F64, down: npt.ArrayLike = (0.0, 1.0, 0.0)
) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """Make the world-to-camera rotation with `forward` as its Z axis.

    Its Y axis is as near to `down` as it can be.
    """
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
