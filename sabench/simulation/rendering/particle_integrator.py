"""Integrator of glowing balls behind dielectric planes, in Mitsuba's scene.

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

from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.camera_rays import (
    mark_unobstructed,
    pinhole_rays,
    pixels_of_rows,
    render_rows,
)
from sabench.utils.arrays import F32, F64

_MAX_HITS = 4096
_NONE = 0xFFFFFFFF


@dataclass(frozen=True)
class Cloud:
    """Glowing balls around particles, in the frame of the render.

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


def render(
    scene: Any,
    camera: Camera,
    origin: F64,
    cloud: Cloud,
    interfaces: int,
    side: int,
    occluders: tuple[Disc, ...],
) -> F32:
    """Render radiance (rows, columns) in front of the lens.

    The side x side rays of a pixel form a regular grid.

    Parameters
    ----------
    origin : world point that is the scene's (0, 0, 0).
    interfaces : dielectric planes that a ray crosses before it may meet a ball.
    occluders : discs in front of all interfaces (or balls); a ray that meets one carries nothing.
    """
    tables = _Tables(cloud, interfaces)

    def trace(first: int, count: int) -> Any:
        rays = _rays(camera, origin, first, count, side)
        return _trace(scene, rays, tables, mark_unobstructed(rays, occluders, origin))

    return render_rows(camera, side * side, trace)


class _Tables:
    """Device copy of a cloud."""

    def __init__(self, cloud: Cloud, interfaces: int) -> None:
        self.centers, self.a, self.b = (
            mi.Point3f(np.ascontiguousarray(v.T, dtype=np.float32))
            for v in (cloud.centers, cloud.a, cloud.b)
        )
        self.radiance = mi.Float(cloud.radiance.astype(np.float32))
        self.interfaces = dr.opaque(mi.UInt32, interfaces)
        self.radius = dr.opaque(
            mi.Float, float((np.linalg.norm(cloud.centers, axis=1) + cloud.radii).max())
        )
        self.advance = dr.opaque(mi.Float, 0.01 * float(np.median(cloud.radii)))


def _rays(camera: Camera, origin: F64, first: int, count: int, side: int) -> Any:
    """Make rays of `count` rows from row `first` on, pixel by pixel."""
    row, column, sub = pixels_of_rows(camera, count, side * side)
    across = mi.Float(column) + (mi.Float(sub % side) + 0.5) / side - 0.5
    down = mi.Float(row) + (mi.Float(sub // side) + 0.5) / side - 0.5
    return pinhole_rays(camera, origin, across, down, first)


@dr.syntax
def _trace(scene: Any, ray: Any, cloud: Any, free: Any) -> Any:
    """Trace the radiance along `free` rays.

    Interfaces transmit by Mitsuba's rules; every ball that is entered in the fluid adds its glow.

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
        ahead = -dr.dot(ray.o, ray.d) - cloud.radius
        ray.o = dr.select(
            (crossed == cloud.interfaces) & (ahead > 0.0), dr.fma(ray.d, ahead, ray.o), ray.o
        )
        si = scene.ray_intersect(ray, mi.RayFlags.All, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        ball = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
        entered = ball & (si.prim_index != last) & (crossed == cloud.interfaces)
        position = dr.fma(ray.d, si.t, ray.o)
        offset = position - dr.gather(mi.Point3f, cloud.centers, si.prim_index, entered)
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
        ray.o = dr.fma(ray.d, cloud.advance, position)
        hits += 1
        active &= (hits < _MAX_HITS) & (weight > 0.0)
    return result
