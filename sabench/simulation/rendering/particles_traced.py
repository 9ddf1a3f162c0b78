"""Mitsuba renderer of tracers behind real dielectric interfaces.

Each particle is a Gaussian glow with a width from the camera's diffraction, defocus and the
particle's disc. Every ray is followed through the dielectric planes (the transmitted direction, its
Fresnel weight and the n^2 law of radiance are Mitsuba's own) and collects the glow of the particles
on its way. Where in the image a particle may be seen at all is taken from its projection, to
whole pixels; where it is seen in there, the rays decide. Pixels take a regular grid of rays, so the
pictures have no Monte Carlo noise: for Gaussians the midpoint rule is nearly exact.
"""

import itertools
import math
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.grid import AT_ONCE
from sabench.geometry.occluders import Disc
from sabench.simulation.rendering.particle_images import REACH, ParticleImages
from sabench.utils import backend
from sabench.utils.arrays import F64, Bool, in_portions
from sabench.utils.compiled import numba


def render(
    camera: Camera,
    images: ParticleImages,
    positions_mm: F64,
    samples: int,
    occluders: tuple[Disc, ...] = (),
) -> F64:
    """Render the photon radiance (rows, columns) of one exposure.

    In photons / (mm2 sr), in front of the lens.

    Parameters
    ----------
    samples : rays per pixel, a square number.
    occluders : discs that stop rays before they reach the wall; a particle behind the edge of one
        is cut there, so all that glow are traced.
    """
    bright = (images.intensity > 0.0) & camera.contains(
        images.pixel, 8.0 * float(np.nanmax(images.sigma_px, initial=0.0)) + 8.0
    )
    if not bright.any():
        return np.zeros((camera.rows, camera.columns))
    mi = backend.mitsuba()
    from sabench.simulation.rendering import particle_integrator  # needs the variant

    # single precision: numbers are small where the particles are
    origin = positions_mm[bright].mean(axis=0)
    cloud = particle_integrator.GlowingBalls(
        positions_mm[bright] - origin,
        *glow_of(images, images.shape_mm(camera, positions_mm), bright),
    )
    walls = interfaces(mi, origin, camera)
    scene = mi.load_dict({"type": "scene", **walls})
    # pixels that may show particles: first, last columns and rows; a last below the first: none
    pixel, size = images.pixel[bright], np.array([camera.columns, camera.rows])
    reach = REACH * np.sqrt(images.spread_px2[bright][:, :2])
    low = np.clip(np.floor(pixel - reach), 0, size).astype(np.int64)
    high = np.clip(np.ceil(pixel + reach), -1, size - 1).astype(np.int64)
    image = np.zeros(camera.rows * camera.columns)
    areas = np.maximum(high - low + 1, 0).prod(axis=1)
    for some in in_portions(areas, AT_ONCE):  # memory does not grow with what particles light up
        starts, near = _list_boxes(low, high, some, camera.columns, image.size)
        lit = np.flatnonzero(np.diff(starts))
        given = camera, origin, cloud, len(walls), (lit, starts, near)
        image[lit] += particle_integrator.integrate_particles(
            scene, *given, math.isqrt(samples), occluders
        )
    return image.reshape(camera.rows, camera.columns)


@numba.njit(cache=True)
def _list_boxes(low: Any, high: Any, some: Any, columns: int, pixels: int) -> Any:
    """List the boxes on each pixel: starts (pixels + 1,) of numbers, and all numbers."""
    starts = np.zeros(pixels + 1, np.int64)
    for n in some:
        for row in range(low[n, 1], high[n, 1] + 1):
            for column in range(low[n, 0], high[n, 0] + 1):
                starts[row * columns + column + 1] += 1
    for place in range(pixels):
        starts[place + 1] += starts[place]
    near, ends = np.empty(starts[-1], np.int64), starts.copy()
    for n in some:
        for row in range(low[n, 1], high[n, 1] + 1):
            for column in range(low[n, 0], high[n, 0] + 1):
                pixel = row * columns + column
                near[ends[pixel]] = n
                ends[pixel] += 1
    return starts, near


def glow_of(images: ParticleImages, shape_mm: F64, bright: Bool) -> tuple[F64, F64, F64, F64]:
    """Compute each particle's Gaussian: radius, covectors a, b and peak radiance.

    The radiance integrates to the radiant intensity: I = L 2 pi |s x t| for a Gaussian with the
    half axes s, t.
    """
    s, t = shape_mm[bright, 0], shape_mm[bright, 1]
    normal = np.cross(s, t)
    area = np.linalg.norm(normal, axis=1)
    unit = normal / area[:, None]
    a = np.cross(t, unit) / area[:, None]
    b = np.cross(unit, s) / area[:, None]
    # Frobenius norm: at least the largest half axis
    radii = REACH * np.linalg.norm(shape_mm[bright], axis=(1, 2))
    return radii, a, b, images.intensity[bright] / (2.0 * np.pi * area)


def balls(mi: Any, centers: F64, radii: F64) -> dict[str, Any]:
    """Describe balls that hold the glow, whatever its axes."""
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(centers), 1))
    data = np.hstack([centers, np.repeat(radii[:, None], 3, axis=1), quaternion])
    return ellipsoids(mi, data)


def ellipsoids(mi: Any, data: F64) -> dict[str, Any]:
    """Describe ellipsoids by centre, semi-axes and quaternion (n, 10)."""
    tensor = mi.TensorXf(data.astype(np.float32))
    return {"type": "ellipsoids", "data": tensor, "extent": 1.0, "bsdf": {"type": "diffuse"}}


def interfaces(mi: Any, origin: F64, camera: Camera) -> dict[str, Any]:
    """Describe the dielectric interfaces of a camera's wall.

    They are planes, or coaxial cylinders, whose normals point outwards.
    """
    wall = camera.wall
    if wall is None:
        return {}
    half = 4.0 * float(np.linalg.norm(np.asarray(camera.center_mm) - origin))
    shapes: list[dict[str, Any]] = []
    if isinstance(wall, CylinderWall):
        axis, foot = np.asarray(wall.axis), np.asarray(wall.axis_point_mm) - origin
        middle = foot - np.dot(foot, axis) * axis
        ends = {"p0": (middle - half * axis).tolist(), "p1": (middle + half * axis).tolist()}
        shapes += [{"type": "cylinder", **ends, "radius": float(r)} for r in wall.radii_mm]
    else:
        normal = np.asarray(wall.normal)
        up = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))]).tolist()
        size = mi.ScalarTransform4f().scale([half, half, 1.0])
        foot = origin - wall.depth_of(origin) * normal  # the outer face next to the particles
        for depth in wall.interface_depths_mm:
            position = foot + depth * normal - origin
            frame = mi.ScalarTransform4f().look_at(
                origin=position.tolist(), target=(position - normal).tolist(), up=up
            )
            shapes.append({"type": "rectangle", "to_world": frame @ size})
    media = itertools.pairwise(float(index) for index in wall.indices)
    return {
        f"interface_{i}": {
            **shape,
            "bsdf": {"type": "dielectric", "ext_ior": outside, "int_ior": inside},
        }
        for i, (shape, (outside, inside)) in enumerate(zip(shapes, media, strict=True))
    }
