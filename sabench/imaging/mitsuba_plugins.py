"""sabench's camera and integrator inside Mitsuba.

Import this module only through sabench.backend.mitsuba(): its base classes exist once a variant is set, and it registers for that one.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from sabench.arrays import F64
from sabench.optics.camera import Camera, Distortion

_MAX_HITS = 4096
_CLEARANCE_MM = 1.0  # more than any ball's radius
_ADVANCE_MM = 2e-3  # past a surface that was met; a second ball that begins within it is lost, one in thousands
_NONE = 0xFFFFFFFF


class SabenchCamera(mi.Sensor):
    """A pinhole with an off-centre principal point and radial-tangential distortion, as sabench.optics.camera has it."""

    def prepare(self, camera: Camera, origin: F64) -> None:
        self.origin = mi.Point3f(*(np.asarray(camera.center_mm) - origin).tolist())
        self.axes = [mi.Vector3f(*axis) for axis in camera.rotation]
        self.size = (camera.columns, camera.rows)
        self.camera = camera

    def sample_ray_differential(self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True) -> Any:
        ray, weight = self.sample_ray(time, wavelength, position, aperture, active)
        return mi.RayDifferential3f(ray), weight

    def sample_ray(self, time: Any, wavelength: Any, position: Any, aperture: Any, active: Any = True) -> Any:
        camera = self.camera
        center = camera.principal_point_px
        u = (position.x * self.size[0] - (0.5 + center[0])) / camera.focal_px
        v = (position.y * self.size[1] - (0.5 + center[1])) / camera.focal_px
        x, y = _undistorted(camera.distortion, u, v)
        return mi.Ray3f(self.origin, dr.normalize(x * self.axes[0] + y * self.axes[1] + self.axes[2])), mi.Color1f(1.0)


class Glow(mi.SamplingIntegrator):
    """Transmit at dielectrics, add the Gaussian glow of every ball that a ray enters in the fluid.

    Mitsuba intersects balls in single precision, whose error grows with the square of the distance from the ray's origin: a ray is
    therefore moved up to the cloud (a sphere around the frame's origin) before it looks for balls, and a ball that it meets twice
    running, by rounding, counts once.
    """

    def prepare(self, centers: F64, a: F64, b: F64, radiance: F64, interfaces: int) -> None:
        self.centers, self.a, self.b = (mi.Point3f(v.T.astype(np.float32)) for v in (centers, a, b))
        self.radiance = mi.Float(radiance.astype(np.float32))
        self.interfaces = mi.UInt32(interfaces)
        self.reach = mi.Float(float(np.linalg.norm(centers, axis=1).max()) + _CLEARANCE_MM)

    @dr.syntax
    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        ray = mi.Ray3f(ray)
        active = mi.Bool(active)
        result, weight = mi.Float(0.0), mi.Float(1.0)
        hits, crossed, last = mi.UInt32(0), mi.UInt32(0), mi.UInt32(_NONE)
        context = mi.BSDFContext()
        context.type_mask = mi.BSDFFlags.DeltaTransmission
        while active:
            ahead = -dr.dot(ray.o, ray.d) - self.reach
            ray.o = dr.select((crossed == self.interfaces) & (ahead > 0.0), dr.fma(ray.d, ahead, ray.o), ray.o)
            si = scene.ray_intersect(ray, mi.RayFlags.All, active)
            active &= si.is_valid()
            bsdf = si.bsdf()
            ball = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse)
            entered = ball & (si.prim_index != last) & (crossed == self.interfaces)
            place = dr.fma(ray.d, si.t, ray.o)
            offset = place - dr.gather(mi.Point3f, self.centers, si.prim_index, entered)
            first = dr.dot(dr.gather(mi.Point3f, self.a, si.prim_index, entered), offset)
            second = dr.dot(dr.gather(mi.Point3f, self.b, si.prim_index, entered), offset)
            glow = dr.exp(-0.5 * (first * first + second * second))
            result += dr.select(entered, weight * glow * dr.gather(mi.Float, self.radiance, si.prim_index, entered), 0.0)
            last = dr.select(ball, si.prim_index, last)
            wall = active & ~ball
            sampled, value = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5), wall)
            weight = dr.select(wall, weight * value.x, weight)
            crossed += dr.select(wall, mi.UInt32(1), mi.UInt32(0))
            ray.d = dr.select(wall, si.to_world(sampled.wo), ray.d)
            ray.o = dr.fma(ray.d, _ADVANCE_MM, place)
            hits += 1
            active &= (hits < _MAX_HITS) & (weight > 0.0)
        return mi.Color1f(result), mi.Bool(True), []


def _undistorted(lens: Distortion, u: Any, v: Any) -> tuple[Any, Any]:
    """Fixed-point inverse of the distortion; single precision is reached in a dozen steps."""
    x, y = u, v
    for _ in range(0 if lens == Distortion() else 12):
        s = x * x + y * y
        radial = s * (lens.k1 + s * (lens.k2 + s * lens.k3))
        shift_x = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (s + 2.0 * x * x)
        shift_y = y * radial + lens.p1 * (s + 2.0 * y * y) + 2.0 * lens.p2 * x * y
        x, y = u - shift_x, v - shift_y
    return x, y


mi.register_sensor("sabench_camera", lambda props: SabenchCamera(props))
mi.register_integrator("sabench_glow", lambda props: Glow(props))
