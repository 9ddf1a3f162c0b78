"""Particle images in one camera: position, photons, size.

Both renderers start from these figures.

The lens is a round aperture. Moving the pinhole over it gives, through the wall, the directions in
which light must leave a particle to pass it: the spread of these directions is the solid angle of
the lens, the spread of the pixels is the defocus.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sabench.api.truth import Particles, View
from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc, in_shadow
from sabench.geometry.refraction import trace_to_points, transmittance
from sabench.scenes import Scene
from sabench.simulation.rendering.laser_sheet import fluence
from sabench.simulation.rendering.mie import MieTable, mie_table
from sabench.utils.arrays import F64, Bool

_AIRY = 2.44 / np.sqrt(
    8 * 3.67
)  # sigma of the Gaussian nearest to Airy's disc / (lambda N (1 + M)): Adrian and Yao (1985)
_CHUNK = 8192  # points at a time


@dataclass(frozen=True)
class ParticleImages(View):
    """Images of n particles in one camera, and the light that leaves for them.

    Attributes
    ----------
    intensity : (n,) photons per steradian that leave the particle towards the camera, before
        anything obstructs them.
    direction : (n, 3) unit direction of the light path at the particle, away from the camera.
    """

    intensity: F64
    direction: F64

    def shape_mm(self, camera: Camera, position_mm: F64) -> F64:
        """Compute vectors across the light path that span a particle's Gaussian.

        (n, 2, 3). A shift of the particle by one of them shifts its image by sigma_px along the
        columns or the rows.
        """
        return np.asarray(
            _apply_in_chunks(_object_shape, camera, position_mm, self.direction)[1]
            * self.sigma_px[:, None, None]
        )


def scattering_table(
    scene: Scene, cameras: tuple[Camera, ...], particles: Particles
) -> MieTable | None:
    """Tabulate Mie scattering from the volume to all cameras.

    None for isotropic scattering or no particles.
    """
    if scene.light.scattering == "isotropic" or not len(particles):
        return None
    index = complex(scene.tracer.index, -scene.tracer.absorption)
    fluid = scene.wall.fluid_index if scene.wall else 1.0
    return mie_table(
        particles.diameter_mm, index, fluid, scene.light.wavelength_nm, _angle_range(scene, cameras)
    )


def _angle_range(scene: Scene, cameras: tuple[Camera, ...]) -> tuple[float, float]:
    """Find smallest and largest scattering angle over a lattice in the volume.

    A margin allows for the apertures and for points between the lattice's.
    """
    steps = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 3), axis=-1).reshape(-1, 3)
    lattice = np.asarray(scene.volume.center_mm) + steps * np.asarray(scene.volume.size_mm)
    angles = []
    for camera in cameras:
        paths = trace_to_points(camera.wall, np.asarray(camera.center_mm), lattice)
        angles.append(_scattering_angles(scene, paths.arriving[paths.valid]))
    every = np.concatenate(angles)
    margin = 0.01 + 2.0 * max(camera.aperture_radius_mm / camera.focus_mm for camera in cameras)
    return float(every.min() - margin), float(every.max() + margin)


def image_particles(
    scene: Scene,
    camera: Camera,
    particles: Particles,
    table: MieTable | None,
    occluders: tuple[Disc, ...] = (),
) -> ParticleImages:
    """Compute position, brightness and size of every particle's image.

    Photons = intensity x solid angle of the lens x Fresnel transmission of the wall; intensity =
    fluence x dC/dOmega averaged over the lens. The image is Gaussian with the summed variances of
    the particle's disc (M d / 4), of diffraction (Airy, `_AIRY`) and of defocus (a disc, diameter /
    4): Adrian and Yao (1985), Olsen and Adrian (2000).
    """
    seen = _LightPaths(*_apply_in_chunks(_see, camera, particles.position_mm))
    unobstructed = seen.valid & ~in_shadow(occluders, np.asarray(camera.center_mm), seen.leaving)
    half_angle = float(np.nanmedian(seen.half_angle)) if len(particles) else 0.0
    intensity = fluence(
        scene.light, np.asarray(scene.volume.center_mm), particles.position_mm
    ) * _cross_section(scene, particles, seen.arriving, table, half_angle)
    photons = np.where(
        unobstructed, intensity * seen.solid_angle * transmittance(camera.wall, seen.leaving), 0.0
    )
    given = scene.cameras.particle_sigma_px
    sigma = (
        _sigma_px(scene, camera, particles, seen)
        if given is None
        else np.full(len(particles), given)
    )
    visible = unobstructed & camera.contains(seen.pixel)
    return ParticleImages(seen.pixel, photons, sigma, visible, intensity, seen.arriving)


def _sigma_px(scene: Scene, camera: Camera, particles: Particles, seen: _LightPaths) -> F64:
    """Compute standard deviations of images from diffraction, disc and defocus.

    The disc is the particle's.
    """
    magnification = _apply_in_chunks(_object_shape, camera, particles.position_mm, seen.arriving)[0]
    variance = (
        diffraction_px(camera, scene.light.wavelength_nm) ** 2
        + (magnification * particles.diameter_mm / 4.0) ** 2
        + (seen.blur / 4.0) ** 2
    )
    return np.asarray(np.sqrt(variance))


def diffraction_px(camera: Camera, wavelength_nm: float) -> float:
    """Compute the standard deviation of the Gaussian that approximates the Airy disc."""
    return float(
        _AIRY
        * wavelength_nm
        * 1e-6
        * camera.f_number
        * camera.principal_distance_mm
        / camera.focal_length_mm
        / camera.pixel_mm
    )


class _LightPaths(NamedTuple):
    """Light paths from n points to one camera: arrays of n rows."""

    leaving: F64
    arriving: F64
    pixel: F64
    valid: Bool
    half_angle: F64
    blur: F64
    solid_angle: F64


def _apply_in_chunks(
    function: Callable[..., tuple[F64 | Bool, ...]], camera: Camera, *points: F64
) -> list[Any]:
    """Apply a function of points (n, 3) chunk by chunk.

    What lies between its steps then stays in the cache: three times as fast for many points.
    """
    chunks = [
        function(camera, *(each[first : first + _CHUNK] for each in points))
        for first in range(0, max(len(points[0]), 1), _CHUNK)
    ]
    return [np.concatenate(parts) for parts in zip(*chunks, strict=True)]


def _see(camera: Camera, points: F64) -> tuple[F64 | Bool, ...]:
    paths = trace_to_points(camera.wall, np.asarray(camera.center_mm), points)
    pixel, valid = camera.pixels_of(paths.leaving, paths.valid)
    return (
        paths.leaving,
        paths.arriving,
        pixel,
        valid,
        *_through_aperture(camera, points, paths.arriving),
    )


def _through_aperture(camera: Camera, points: F64, chief: F64) -> tuple[F64, F64, F64]:
    """Compute the lens's half angle (rad), defocus (px) and solid angle (sr).

    At each point (n,), in the fluid.
    """
    radius = camera.aperture_radius_mm
    rotations, smears = [], []
    for axis, (right, down) in enumerate(((radius, 0.0), (0.0, radius))):
        ends = []
        for sign in (1.0, -1.0):
            moved = camera.shifted(sign * right, sign * down)
            paths = trace_to_points(moved.wall, np.asarray(moved.center_mm), points)
            ends.append((paths.arriving, moved.pixels_of(paths.leaving, paths.valid)[0]))
        rotations.append((ends[0][0] - ends[1][0]) / 2.0)
        smear = ends[0][1] - ends[1][1]
        smear[:, axis] += (
            2.0 * radius * camera.focal_px / camera.focus_mm
        )  # a point in focus would shift by this, and is at rest on the sensor
        smears.append(np.linalg.norm(smear, axis=1))
    solid_angle = np.pi * np.abs(np.einsum("ij,ij->i", np.cross(rotations[0], rotations[1]), chief))
    return (
        np.linalg.norm(rotations[0], axis=1),
        np.sqrt((smears[0] ** 2 + smears[1] ** 2) / 2.0),
        solid_angle,
    )


def _object_shape(camera: Camera, points: F64, direction: F64) -> tuple[F64, F64]:
    """Compute magnification and the shifts that move the image by one pixel.

    In px/mm, mean over directions; shifts (n, 2, 3) lie across the light path.
    """
    step = 1e-3  # mm: far above float64's noise, far below any change of magnification
    first = np.cross(
        direction, camera.rotation[1]
    )  # never along the path: a path in view is near the camera's Z axis
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    basis = np.stack([first, np.cross(direction, first)], axis=1)
    ends = [
        camera.project(points + sign * step * basis[:, i])[0]
        for i in (0, 1)
        for sign in (1.0, -1.0)
    ]
    jacobian = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=2) / (2.0 * step)
    determinant = jacobian[:, 0, 0] * jacobian[:, 1, 1] - jacobian[:, 0, 1] * jacobian[:, 1, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        adjugate = np.stack(
            [jacobian[:, 1, 1], -jacobian[:, 0, 1], -jacobian[:, 1, 0], jacobian[:, 0, 0]], axis=1
        ).reshape(-1, 2, 2)
        inverse = adjugate / determinant[:, None, None]
    return np.sqrt(np.abs(determinant)), np.einsum("nba,nbk->nak", inverse, basis)


def _cross_section(
    scene: Scene, particles: Particles, arriving: F64, table: MieTable | None, half_angle: float
) -> F64:
    """Compute the differential cross-section towards the camera, mm2/sr.

    Isotropic scattering spreads the geometric cross-section over the sphere.
    """
    if table is None:
        return np.asarray(particles.diameter_mm**2 / 16.0)
    angles = _scattering_angles(scene, arriving)
    return table.average(half_angle).cross_section(angles, particles.diameter_mm)


def _scattering_angles(scene: Scene, arriving: F64) -> F64:
    """Compute the angle between the laser's direction and light to the camera, rad."""
    forward = np.asarray(scene.light.direction) / np.linalg.norm(scene.light.direction)
    return np.asarray(np.arccos(np.clip(-arriving @ forward, -1.0, 1.0)))
