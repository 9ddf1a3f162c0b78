"""Light that particles send towards a camera.

The laser's, on its way through the cloud, times what each particle scatters by itself.
"""

from __future__ import annotations

import functools

import numpy as np

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import trace_to_points
from sabench.scenes import Scene
from sabench.simulation.rendering.laser_sheet import fluence
from sabench.simulation.rendering.scattering import Scattering
from sabench.utils.arrays import F64, I64
from sabench.worlds.tracers import material_numbers


class Scatterers:
    """All materials of a scene's particles, and which particle is of which.

    Tables grow with the sizes that occur and serve all frames, and other scenes with the same rig.

    Parameters
    ----------
    scene : with the laser as it is in the fluid.
    seed : of the data set.
    """

    def __init__(self, scene: Scene, cameras: tuple[Camera, ...], seed: int) -> None:
        self._tracer, self._seed = scene.tracer, seed
        every = (scene.tracer, *(scene.tracer.mixture or ()))
        self._materials = _tables(
            tuple(complex(one.index, -one.absorption) for one in every),
            (scene.fluid_index, scene.light.wavelength_nm),
            (scene.volume.center_mm, scene.volume.size_mm, scene.light.direction),
            cameras,
        )

    def cross_section(self, particles: Particles, angles: F64, half: F64, in_plane: F64) -> F64:
        """Compute differential cross-sections (n,), mm2/sr, as `Scattering` does."""
        out, numbers = np.empty(len(particles)), self._numbers(particles)
        for number, material in enumerate(self._materials):
            own = numbers == number
            given = (angles[own], half[own], in_plane[own])
            out[own] = material.cross_section(particles.diameter_mm[own], *given)
        return out

    def extinction_mm2(self, particles: Particles) -> F64:
        """Compute extinction cross-sections (n,)."""
        out, numbers = np.empty(len(particles)), self._numbers(particles)
        for number, material in enumerate(self._materials):
            own = numbers == number
            out[own] = material.extinction_mm2(particles.diameter_mm[own])
        return out

    def _numbers(self, particles: Particles) -> I64:
        return material_numbers(self._tracer, self._seed, particles.id)


@functools.lru_cache(maxsize=8)
def _tables(
    indices: tuple[complex, ...],
    medium: tuple[float, float],
    place: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]],
    cameras: tuple[Camera, ...],
) -> tuple[Scattering, ...]:
    """Make a table for each material.

    The medium is the fluid's index and a wavelength, the place a box and the laser's direction.
    """
    angles = _angle_range(*place, cameras)
    return tuple(Scattering(index, *medium, angles) for index in indices)


def scatterers_of(scene: Scene, cameras: tuple[Camera, ...], seed: int) -> Scatterers | None:
    """Return how particles scatter; None for isotropic scattering."""
    return None if scene.light.scattering == "isotropic" else Scatterers(scene, cameras, seed)


def intensity(
    scene: Scene, particles: Particles, arriving: F64, half: F64, scatterers: Scatterers | None
) -> F64:
    """Compute photons per steradian (n,) that leave particles towards a camera.

    Fluence times dC/dOmega averaged over the lens. Isotropic scattering spreads the geometric
    cross-section over the sphere.

    Parameters
    ----------
    arriving : (n, 3) unit directions of the light paths at the particles, away from the camera.
    half : (n,) the lens's half angle, rad, at the particles.
    """
    light, center = scene.light, np.asarray(scene.volume.center_mm)
    photons = fluence(light, center, particles.position_mm)
    if light.extinction:
        photons *= _transmission(scene, particles, arriving, scatterers)
    if scatterers is None:
        return photons * particles.diameter_mm**2 / 16.0
    in_plane = np.full(len(particles), 0.5)
    if light.polarisation is not None:
        towards = -arriving
        along = np.asarray(light.direction) / np.linalg.norm(light.direction)
        field = np.asarray(light.polarisation) / np.linalg.norm(light.polarisation)
        across = towards - (towards @ along)[:, None] * along
        length = np.einsum("ij,ij->i", across, across)
        in_plane = np.asarray((across @ field) ** 2 / np.maximum(length, 1e-300))
    angles = _scattering_angles(light.direction, arriving)
    return photons * scatterers.cross_section(particles, angles, half, in_plane)


def _transmission(
    scene: Scene, particles: Particles, arriving: F64, scatterers: Scatterers | None
) -> F64:
    """Compute what a cloud leaves of the light (n,).

    On the way to a particle, and from there to the camera: Beer and Lambert's law with the mean of
    the particles' extinction per volume. What one scatters forward counts as lost: it is spread
    over some degrees.
    """
    if scatterers is None:
        cross_section = np.pi / 4.0 * particles.diameter_mm**2
    else:
        cross_section = scatterers.extinction_mm2(particles)
    size = np.asarray(scene.volume.size_mm)
    per_mm = cross_section.sum() / size.prod()
    along = np.asarray(scene.light.direction) / np.linalg.norm(scene.light.direction)
    place = particles.position_mm - np.asarray(scene.volume.center_mm)
    path = _way_out(place, np.broadcast_to(-along, place.shape), size)
    return np.asarray(np.exp(-per_mm * (path + _way_out(place, -arriving, size))))


def _way_out(place_mm: F64, direction: F64, size_mm: F64) -> F64:
    """Compute distances (n,) to the faces of a box about the origin; 0 outside."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.copysign(size_mm / 2.0, direction) - place_mm) / direction
    distance = np.where(direction == 0.0, np.inf, distance)
    inside = (np.abs(place_mm) <= size_mm / 2.0).all(axis=1)
    return np.asarray(np.where(inside, distance.min(axis=1), 0.0))


def _angle_range(
    center_mm: tuple[float, ...],
    size_mm: tuple[float, ...],
    direction: tuple[float, ...],
    cameras: tuple[Camera, ...],
) -> tuple[float, float]:
    """Find smallest and largest scattering angle over a lattice in the volume.

    A margin allows for the apertures and for points between the lattice's.
    """
    steps = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 9)] * 3), axis=-1).reshape(-1, 3)
    lattice = np.asarray(center_mm) + steps * np.asarray(size_mm)
    angles = []
    for camera in cameras:
        paths = trace_to_points(camera.wall, np.asarray(camera.center_mm), lattice)
        angles.append(_scattering_angles(direction, paths.arriving[paths.valid]))
    every = np.concatenate(angles)
    margin = 0.01 + 2.0 * max(camera.aperture_radius_mm / camera.focus_mm for camera in cameras)
    return float(every.min() - margin), float(every.max() + margin)


def _scattering_angles(direction: tuple[float, ...], arriving: F64) -> F64:
    forward = np.asarray(direction) / np.linalg.norm(direction)
    return np.asarray(np.arccos(np.clip(-arriving @ forward, -1.0, 1.0)))
