"""Follow rays through dielectric planes into a cloud of glowing balls, inside Mitsuba's scene.

Import this module only after sabench.utils.backend.mitsuba(): its types are those of the variant
that is set then. (@dr.syntax sees module globals only, so the functions cannot live inside another
one that sets the variant.)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt

from sabench.geometry.camera import Camera, Distortion
from sabench.geometry.occluders import Disc
from sabench.utils.arrays import F32, F64

_MAX_HITS = 4096
_NONE = 0xFFFFFFFF
_WAVEFRONT = 1 << 22  # rays traced at once: bounds memory, not results


@dataclass(frozen=True)
class Cloud:
    """Balls around glowing particles, in the frame of the render.

    Attributes
    ----------
    centers : (n, 3) mm.
    radii : (n,) mm, of the balls.
    a, b : (n, 3) covectors, 1/mm: the glow at an offset x from the centre is radiance exp(-((a x)^2
        + (b x)^2) / 2).
    radiance : (n,) peak, photons / (mm2 sr) in the fluid.
    """

    centers: F64
    radii: F64
    a: F64
    b: F64
    radiance: F64


def picture(
    scene: Any,
    camera: Camera,
    origin: F64,
    cloud: Cloud,
    interfaces: int,
    side: int,
    occluders: tuple[Disc, ...],
) -> F32:
    """Radiance (rows, columns) in front of the lens: each pixel's mean over a regular grid of side x side rays.

    Rays of one pixel are neighbours and are added up in their order, so that the picture does not
    depend on how threads are scheduled (a film, to which threads add as they finish, would).

    Parameters
    ----------
    origin : world point that is the scene's (0, 0, 0).
    interfaces : dielectric planes that a ray crosses before it may meet a ball.
    occluders : discs in front of all interfaces (or balls); a ray that meets one carries nothing.
    """
    tables = _Tables(cloud, interfaces)
    samples = side * side
    rows = max(1, _WAVEFRONT // (camera.columns * samples))
    bands = []
    for first in range(0, camera.rows, rows):
        count = min(rows, camera.rows - first)
        rays = _rays(camera, origin, first, count, side)
        band = dr.block_sum(
            _trace(scene, rays, tables, unstopped(rays, occluders, origin)), samples
        ) * (1.0 / samples)
        bands.append(np.array(band, dtype=np.float32).reshape(count, camera.columns))
    return np.concatenate(bands)


class _Tables:
    """A cloud on the device."""

    def __init__(self, cloud: Cloud, interfaces: int) -> None:
        self.centers, self.a, self.b = (
            mi.Point3f(np.ascontiguousarray(v.T, dtype=np.float32))
            for v in (cloud.centers, cloud.a, cloud.b)
        )
        self.radiance = mi.Float(cloud.radiance.astype(np.float32))
        self.interfaces = dr.opaque(mi.UInt32, interfaces)
        self.reach = dr.opaque(
            mi.Float, float((np.linalg.norm(cloud.centers, axis=1) + cloud.radii).max())
        )
        self.advance = dr.opaque(mi.Float, 0.01 * float(np.median(cloud.radii)))


def _rays(camera: Camera, origin: F64, first: int, count: int, side: int) -> Any:
    """Rays of `count` rows from row `first` on, pixel by pixel."""
    index = dr.arange(mi.UInt32, count * camera.columns * side * side)
    pixel, sub = index // (side * side), index % (side * side)
    row, column = pixel // camera.columns, pixel % camera.columns
    across = mi.Float(column) + (mi.Float(sub % side) + 0.5) / side - 0.5
    down = mi.Float(row) + (mi.Float(sub // side) + 0.5) / side - 0.5
    center, scale = camera.principal_point_px, 1.0 / camera.focal_px
    u = (across - dr.opaque(mi.Float, center[0])) * dr.opaque(mi.Float, scale)
    v = (down + dr.opaque(mi.Float, first - center[1])) * dr.opaque(mi.Float, scale)
    x, y = undistorted(camera.distortion, u, v)
    right, below, forward = (opaque(axis) for axis in camera.rotation)
    return mi.Ray3f(
        mi.Point3f(opaque(camera.center_mm - origin)), dr.normalize(x * right + y * below + forward)
    )


def opaque(vector: npt.ArrayLike) -> Any:
    """A vector (3,) that all kernels share, whatever its value."""
    return mi.Vector3f(
        *(dr.opaque(mi.Float, value) for value in np.asarray(vector, dtype=np.float64).tolist())
    )


def unstopped(rays: Any, occluders: tuple[Disc, ...], origin: F64) -> Any:
    """Whether no disc stops a ray: the same test as Disc.stops."""
    free = mi.Bool(True)
    for disc in occluders:
        offset, normal = mi.Point3f(opaque(disc.center_mm - origin)) - rays.o, opaque(disc.normal)
        way = dr.dot(offset, normal) / dr.dot(rays.d, normal)
        free &= ~(
            (way > 0.0) & (dr.norm(way * rays.d - offset) <= dr.opaque(mi.Float, disc.radius_mm))
        )
    return free


def undistorted(lens: Distortion, u: Any, v: Any) -> tuple[Any, Any]:
    """Invert the distortion by a fixed point; single precision is reached in a dozen steps.

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


@dr.syntax
def _trace(scene: Any, ray: Any, cloud: Any, free: Any) -> Any:
    """Radiance along `free` rays: Mitsuba's transmission at dielectrics, plus the glow of every ball that is entered in the fluid.

    Mitsuba intersects balls in single precision, whose error grows with the square of the distance
    from the ray's origin: a ray is therefore moved up to the cloud (a sphere around the scene's
    origin) before it looks for balls, and a ball that it meets twice running, by rounding, counts
    once. A second ball that begins within `advance` of the first is lost: one in thousands.
    """
    ray = mi.Ray3f(ray)
    result, weight = mi.Float(0.0), mi.Float(1.0)
    hits, crossed, last = mi.UInt32(0), mi.UInt32(0), mi.UInt32(_NONE)
    active = mi.Bool(free)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DeltaTransmission
    while active:
        ahead = -dr.dot(ray.o, ray.d) - cloud.reach
        ray.o = dr.select(
            (crossed == cloud.interfaces) & (ahead > 0.0), dr.fma(ray.d, ahead, ray.o), ray.o
        )
        si = scene.ray_intersect(ray, mi.RayFlags.All, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        ball = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        entered = ball & (si.prim_index != last) & (crossed == cloud.interfaces)
        place = dr.fma(ray.d, si.t, ray.o)
        offset = place - dr.gather(mi.Point3f, cloud.centers, si.prim_index, entered)
        offset -= (
            dr.dot(ray.d, offset) * ray.d
        )  # a ball is met in front of its centre, where rays of one pinhole lie closer together
        first = dr.dot(dr.gather(mi.Point3f, cloud.a, si.prim_index, entered), offset)
        second = dr.dot(dr.gather(mi.Point3f, cloud.b, si.prim_index, entered), offset)
        glow = dr.exp(-0.5 * (first * first + second * second))
        result += dr.select(
            entered,
            weight * glow * dr.gather(mi.Float, cloud.radiance, si.prim_index, entered),
            0.0,
        )
        last = dr.select(ball, si.prim_index, last)
        wall = active & ~ball
        sampled, value = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5), wall)
        weight = dr.select(wall, weight * value.x, weight)
        crossed += dr.select(wall, mi.UInt32(1), mi.UInt32(0))
        ray.d = dr.select(wall, si.to_world(sampled.wo), ray.d)
        ray.o = dr.fma(ray.d, cloud.advance, place)
        hits += 1
        active &= (hits < _MAX_HITS) & (weight > 0.0)
    return result
