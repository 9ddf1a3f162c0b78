"""Camera rays of the three integrators, as Dr.Jit arrays.

Import this module only after sabench.utils.backend.mitsuba(): its types are those of the variant
that is set then.
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from sabench.geometry.camera import Camera
from sabench.geometry.grid import AT_ONCE
from sabench.geometry.lens import UPRIGHT, Distortion, focus_slope, sensor_axes
from sabench.geometry.occluders import Disc
from sabench.utils.arrays import F32, F64, I64, U32


def mean_of_rays(numbers: tuple[I64 | U32, ...], samples: int, trace: Callable[..., Any]) -> F32:
    """Compute the mean radiance (n,) of the rays of pixels, some at a time.

    Rays of one pixel are neighbours and are added up in their order, so that the image does not
    depend on how threads are scheduled (as Mitsuba's film would).

    Parameters
    ----------
    numbers : (n,) each; the pixels, numbered row by row, and whatever else they have.
    trace : radiance of rays; arguments: each ray's number in its pixel, and its pixel's numbers.
    """
    count = max(1, AT_ONCE // samples)
    parts = [np.zeros(0, dtype=np.float32)]
    for first in range(0, len(numbers[0]), count):
        part = slice(first, first + count)
        some = [mi.UInt32(one[part].astype(np.uint32, copy=False)) for one in numbers]
        lane = dr.arange(mi.UInt32, dr.width(some[0]) * samples)
        own = [dr.gather(mi.UInt32, one, lane // samples) for one in some]
        mean = dr.block_sum(trace(lane % samples, *own), samples) * (1.0 / samples)
        parts.append(np.array(mean, dtype=np.float32))
    return np.concatenate(parts)


def pinhole_rays(camera: Camera, origin: F64, column: Any, row: Any) -> Any:
    """Make rays from the pinhole.

    Parameters
    ----------
    origin : world point that is the scene's (0, 0, 0).
    column, row : pixel coordinates; (0, 0) is the centre of a pixel.
    """
    x, y = undistort_rays(camera.distortion, *_distorted(camera, column, row))
    right, below, forward = (opaque(axis) for axis in camera.rotation)
    start = mi.Point3f(opaque(np.asarray(camera.center_mm) - origin))
    return mi.Ray3f(start, dr.normalize(x * right + y * below + forward))


def lens_rays(camera: Camera, origin: F64, column: Any, row: Any, lens_mm: tuple[Any, Any]) -> Any:
    """Make rays from points of the aperture to the plane in focus (`pinhole_rays`)."""
    u, v = _distorted(camera, column, row)
    x, y = undistort_rays(camera.distortion, u, v)
    a, b = lens_mm
    right, below, forward = (opaque(axis) for axis in camera.rotation)
    start = mi.Point3f(opaque(np.asarray(camera.center_mm) - origin)) + a * right + b * below
    if camera.tilt_deg == UPRIGHT:
        focus = dr.opaque(mi.Float, camera.focus_mm)
        direction = (x * focus - a) * right + (y * focus - b) * below + focus * forward
    else:  # the plane in focus may pass the horizon, where the inverse of its depth is 0
        slopes = focus_slope(camera.tilt_deg) / camera.principal_distance_mm
        first, second = (dr.opaque(mi.Float, slope) for slope in slopes.tolist())
        near = dr.opaque(mi.Float, 1.0 / camera.focus_mm) - first * u - second * v
        direction = (x - a * near) * right + (y - b * near) * below + forward
    return mi.Ray3f(start, dr.normalize(direction))


def _distorted(camera: Camera, column: Any, row: Any) -> tuple[Any, Any]:
    """Return distorted image coordinates on the plane of an upright sensor.

    A copy of `sensor_tilt.from_sensor` for arrays of Dr.Jit; tied to it by
    test_lens.py::test_renderers_have_the_rays_of_tilted_cameras.
    """
    center, scale = camera.principal_point_px, dr.opaque(mi.Float, 1.0 / camera.focal_px)
    u = (column - dr.opaque(mi.Float, center[0])) * scale
    v = (row - dr.opaque(mi.Float, center[1])) * scale
    if camera.tilt_deg == UPRIGHT:
        return u, v
    right, down, _ = (opaque(axis) for axis in sensor_axes(camera.tilt_deg))
    depth = 1.0 + u * right.z + v * down.z
    return (u * right.x + v * down.x) / depth, (u * right.y + v * down.y) / depth


def undistort_rays(lens: Distortion, u: Any, v: Any) -> tuple[Any, Any]:
    """Invert the distortion by a fixed point; a dozen steps reach single precision.

    A copy of `Camera.ideal`, the reference, for arrays of Dr.Jit; tied to it by
    test_projection_copies.py::test_renderers_undistort_as_cameras_do.
    """
    x, y = u, v
    for _ in range(0 if lens == Distortion() else 12):
        s = x * x + y * y
        radial = s * (lens.k1 + s * (lens.k2 + s * lens.k3))
        shift_x = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (s + 2.0 * x * x)
        shift_y = y * radial + lens.p1 * (s + 2.0 * y * y) + 2.0 * lens.p2 * x * y
        x, y = u - shift_x, v - shift_y
    return x, y


def opaque(vector: npt.ArrayLike) -> Any:
    """Give a vector (3,) to the device; kernels do not depend on its value."""
    values = np.asarray(vector, dtype=np.float64).tolist()
    return mi.Vector3f(*(dr.opaque(mi.Float, value) for value in values))


def mark_unobstructed(rays: Any, occluders: tuple[Disc, ...], origin: F64) -> Any:
    """Mark rays that no disc stops: the same test as Disc.stops."""
    free = mi.Bool(True)
    for disc in occluders:
        offset, normal = mi.Point3f(opaque(disc.center_mm - origin)) - rays.o, opaque(disc.normal)
        distance = dr.dot(offset, normal) / dr.dot(rays.d, normal)
        across = dr.norm(distance * rays.d - offset)
        free &= ~((distance > 0.0) & (across <= dr.opaque(mi.Float, disc.radius_mm)))
    return free
