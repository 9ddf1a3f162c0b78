"""Integrator of glowing particles behind dielectric interfaces, with Mitsuba.

Import this module only after sabench.utils.backend.mitsuba(): its types are those of the variant
that is set then. (@dr.syntax sees module globals only, so the functions cannot live inside another
one that sets the variant.)
"""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.camera_rays import mark_unobstructed, mean_of_rays, pinhole_rays
from sabench.utils.arrays import F32, F64, I64

_ROUNDING = 2e-6  # of distances: rays go on so far behind what they met


@dataclass(frozen=True)
class GlowingBalls:
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


def integrate_particles(
    walls: Any,
    camera: Camera,
    origin: F64,
    cloud: GlowingBalls,
    interfaces: int,
    near: tuple[I64, I64, I64],
    side: int,
    occluders: tuple[Disc, ...],
) -> F32:
    """Render radiance (n,) of pixels in front of the lens.

    The side x side rays of a pixel form a regular grid.

    Parameters
    ----------
    walls : scene of the dielectric interfaces.
    origin : world point that is the scene's (0, 0, 0).
    interfaces : those that a ray crosses before it may meet a particle.
    near : pixels (n,) numbered row by row; where the particles of every pixel start, in a list of
        their numbers; and that list.
    occluders : discs in front of all interfaces (or particles); a ray that meets one carries
        nothing.
    """
    pixels, *lists = near
    device = _Device(cloud, interfaces, camera, origin, *lists)

    def trace(sub: Any, pixel: Any) -> Any:
        across = mi.Float(pixel % camera.columns) + (mi.Float(sub % side) + 0.5) / side - 0.5
        down = mi.Float(pixel // camera.columns) + (mi.Float(sub // side) + 0.5) / side - 0.5
        rays = pinhole_rays(camera, origin, across, down)
        weight = dr.select(mark_unobstructed(rays, occluders, origin), mi.Float(1.0), 0.0)
        if interfaces:
            rays, weight = _enter(walls, rays, weight, device)
        return weight * _collect(rays, pixel, device)

    return mean_of_rays((pixels,), side * side, trace)


class _Device:
    """Device copy of a cloud, and of the particles near each pixel."""

    def __init__(
        self,
        cloud: GlowingBalls,
        interfaces: int,
        camera: Camera,
        origin: F64,
        starts: I64,
        near: I64,
    ) -> None:
        self.centers, self.a, self.b = (
            mi.Point3f(np.ascontiguousarray(v.T, dtype=np.float32))
            for v in (cloud.centers, cloud.a, cloud.b)
        )
        self.radiance = mi.Float(cloud.radiance.astype(np.float32))
        self.starts, self.near = (mi.UInt32(one.astype(np.uint32)) for one in (starts, near))
        self.interfaces = dr.opaque(mi.UInt32, interfaces)
        distance = float(np.linalg.norm(np.asarray(camera.center_mm) - origin))
        self.off_wall = dr.opaque(mi.Float, _ROUNDING * distance)


@dr.syntax
def _enter(walls: Any, ray: Any, weight: Any, device: Any) -> Any:
    """Follow rays through the interfaces, which transmit by Mitsuba's rules.

    Returns the rays behind them and their weights: 0 for those that do not come through.
    """
    ray = mi.Ray3f(ray)
    weight = mi.Float(weight)
    crossed = mi.UInt32(0)
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DeltaTransmission
    flags = mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame
    while (crossed < device.interfaces) & (weight > 0.0):
        si = walls.ray_intersect(ray, flags, coherent=True)
        met = si.is_valid()
        sampled, value = si.bsdf().sample(context, si, mi.Float(0.5), mi.Point2f(0.5), met)
        weight = dr.select(met, weight * value.x, 0.0)
        ray.o = dr.select(met, dr.fma(ray.d, si.t, ray.o), ray.o)
        ray.d = dr.select(met, si.to_world(sampled.wo), ray.d)
        ray.o = dr.fma(ray.d, device.off_wall, ray.o)
        crossed += 1
    return ray, weight


@dr.syntax
def _collect(ray: Any, pixel: Any, device: Any) -> Any:
    """Add up the radiance of the glow that rays in the fluid meet.

    It is that at a ray's nearest point to each particle. Numbers are small in single precision, as
    a ray is first moved to its nearest point to the scene's origin.
    """
    result = mi.Float(0.0)
    start = dr.fma(ray.d, -dr.dot(ray.o, ray.d), ray.o)
    place = dr.gather(mi.UInt32, device.starts, pixel)
    end = dr.gather(mi.UInt32, device.starts, pixel + 1)
    while place < end:
        particle = dr.gather(mi.UInt32, device.near, place)
        offset = start - dr.gather(mi.Point3f, device.centers, particle)
        offset -= dr.dot(ray.d, offset) * ray.d
        first = dr.dot(dr.gather(mi.Point3f, device.a, particle), offset)
        second = dr.dot(dr.gather(mi.Point3f, device.b, particle), offset)
        glow = dr.exp(-0.5 * (first * first + second * second))
        result += glow * dr.gather(mi.Float, device.radiance, particle)
        place += 1
    return result
