"""Mitsuba renderer: rays from each pixel through real dielectric interfaces into a cloud of glowing particles.

Each particle is one primitive of an `ellipsoids` shape: a ball around a Gaussian glow whose width is the one that the camera's
diffraction, defocus and the particle's disc give it. The integrator follows every ray through the dielectric planes (the transmitted
direction, its Fresnel weight and the n^2 law of radiance are Mitsuba's own) and adds the glow of all balls on its way.
Pixels take a regular grid of rays, so the pictures have no Monte Carlo noise: for Gaussians the midpoint rule is nearly exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench import backend
from sabench.arrays import F64
from sabench.imaging.particle_images import ParticleImages
from sabench.optics.camera import Camera
from sabench.optics.wall import Wall

_REACH = 4.0  # standard deviations from a particle's centre to its ball's surface; 3e-4 of the light lies outside


def render(camera: Camera, images: ParticleImages, positions_mm: F64, samples: int) -> F64:
    """Photon radiance image (rows, columns), photons / (mm2 sr) in front of the lens, of one exposure.

    Parameters
    ----------
    samples : rays per pixel, a square number.
    """
    lit = (images.photons > 0.0) & camera.contains(images.pixel, 8.0 * float(np.nanmax(images.sigma_px, initial=0.0)) + 8.0)
    if not lit.any():
        return np.zeros((camera.rows, camera.columns))
    mi = backend.mitsuba()
    from sabench.imaging import mitsuba_plugins  # noqa: F401  registers the camera and the integrator, which needs the variant

    origin = positions_mm[lit].mean(axis=0)  # single precision: the numbers are small where the particles are
    glow = _glow(images, lit)
    scene = mi.load_dict(
        {"type": "scene", **_interfaces(mi, camera.wall, origin, camera), "cloud": _cloud(mi, positions_mm[lit] - origin, images, lit)}
    )
    integrator = mi.load_dict({"type": "sabench_glow"})
    integrator.prepare(positions_mm[lit] - origin, *glow, _count_interfaces(camera.wall))
    film = {"type": "hdrfilm", "width": camera.columns, "height": camera.rows, "pixel_format": "luminance", "rfilter": {"type": "box"}}
    sampler = {"type": "stratified", "jitter": False, "sample_count": samples}
    sensor = mi.load_dict({"type": "sabench_camera", "film": film, "sampler": sampler})
    sensor.prepare(camera, origin)
    picture = mi.render(scene, sensor=sensor, integrator=integrator, spp=samples)
    return np.asarray(picture, dtype=np.float64).reshape(camera.rows, camera.columns)


def _count_interfaces(wall: Wall | None) -> int:
    return len(wall.layers) + 1 if wall else 0


def _glow(images: ParticleImages, lit: np.ndarray[Any, Any]) -> tuple[F64, F64, F64]:
    """Per particle two covectors a, b with exp(-((a x)^2 + (b x)^2) / 2) its profile across the light path, and its peak radiance.

    The radiance integrates to the radiant intensity: I = L 2 pi |s x t| for a Gaussian with the half axes s, t.
    """
    s, t = images.shape_mm[lit, 0], images.shape_mm[lit, 1]
    normal = np.cross(s, t)
    area = np.linalg.norm(normal, axis=1)
    unit = normal / area[:, None]
    a = np.cross(t, unit) / area[:, None]
    b = np.cross(unit, s) / area[:, None]
    return a, b, images.intensity[lit] / (2.0 * np.pi * area)


def _cloud(mi: Any, centers: F64, images: ParticleImages, lit: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Balls that hold the glow, whatever its axes."""
    radius = np.linalg.norm(images.shape_mm[lit], axis=(1, 2))  # Frobenius norm: at least the largest half axis
    scale = np.repeat(radius[:, None], 3, axis=1)
    quaternion = np.tile([0.0, 0.0, 0.0, 1.0], (len(centers), 1))
    data = np.hstack([centers, scale, quaternion]).astype(np.float32)
    return {"type": "ellipsoids", "data": mi.TensorXf(data), "extent": _REACH, "bsdf": {"type": "diffuse"}}


def _interfaces(mi: Any, wall: Wall | None, origin: F64, camera: Camera) -> dict[str, Any]:
    """One dielectric rectangle per interface, facing the cameras."""
    if wall is None:
        return {}
    normal = np.asarray(wall.normal)
    foot = origin - wall.depth_of(origin) * normal  # the outer face next to the particles
    half = 4.0 * float(np.linalg.norm(np.asarray(camera.center_mm) - origin))
    shapes = {}
    for i, depth in enumerate(wall.interface_depths_mm):
        place = foot + depth * normal - origin
        frame = mi.ScalarTransform4f().look_at(origin=place.tolist(), target=(place - normal).tolist(), up=_any_across(normal).tolist())
        optics = {"type": "dielectric", "ext_ior": float(wall.indices[i]), "int_ior": float(wall.indices[i + 1])}
        shapes[f"interface_{i}"] = {"type": "rectangle", "to_world": frame @ mi.ScalarTransform4f().scale([half, half, 1.0]), "bsdf": optics}
    return shapes


def _any_across(normal: F64) -> F64:
    return np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
