"""Light that particles send towards a camera.

Source of the Mie series: Bohren and Huffman (1983), chapter 4 and appendix A. The scattering of one
size is tabulated over angles where a particle of that size occurs. Sizes lie on a lattice
(`worlds.tracers`), so that a particle's brightness is that of its own diameter,
independent of the other particles in the frame.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import trace_to_points
from sabench.scenes import Scene
from sabench.simulation.rendering.lamps import fluence
from sabench.utils.arrays import C128, F32, F64, I64, unit
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores
from sabench.worlds.tracers import PER_OCTAVE, lattice_diameters_mm, material_numbers, size_numbers

_BLOCK = 1024  # sizes, and angles, of one product of matrices


def intensities(index: complex, size_parameters: F64, angles_rad: F64) -> tuple[F64, F64]:
    """Compute |S1|^2 and |S2|^2 of spheres: (size, angle) each.

    S1 belongs to light polarised across the plane of scattering, S2 to light polarised in it. Both
    are even functions of the angle, which may be negative.

    Parameters
    ----------
    index : n - i k of the spheres, divided by that of the fluid.
    size_parameters : (size,) pi d n / lambda.

    Source: Bohren and Huffman (1983), eq. 4.74. The sums are taken as products of matrices: S1 + S2
    has the terms (a_n + b_n) (pi_n + tau_n), and S1 - S2 those with differences.
    """
    across, along = np.empty((2, len(size_parameters), len(angles_rad)))
    for top in range(0, len(size_parameters), _BLOCK):
        rows = slice(top, top + _BLOCK)
        a, b = scaled_coefficients(index, size_parameters[rows])
        for left in range(0, len(angles_rad), _BLOCK):
            columns = slice(left, left + _BLOCK)
            pi, tau = _angular_functions(np.cos(angles_rad[columns]), a.shape[1])
            sums = []  # complex matrices times real ones
            for series, functions in ((a + b, pi + tau), (a - b, pi - tau)):
                parts = np.concatenate([series.real, series.imag]) @ functions
                sums.append(parts[: len(series)] + 1j * parts[len(series) :])
            total, difference = sums
            across[rows, columns] = np.abs(total + difference) ** 2 / 4.0
            along[rows, columns] = np.abs(total - difference) ** 2 / 4.0
    return across, along


def extinction_efficiency(index: complex, size_parameters: F64) -> F64:
    """Compute extinction cross-sections (size,) over geometric ones.

    Source: Bohren and Huffman (1983), eq. 4.62.
    """
    a, b = scaled_coefficients(index, size_parameters)
    n = np.arange(1, a.shape[1] + 1)
    return np.asarray(2.0 / size_parameters**2 * ((a + b).real @ (n * (n + 1.0))))


def scaled_coefficients(index: complex, size_parameters: F64) -> tuple[C128, C128]:
    """Compute a_n and b_n times (2 n + 1) / (n (n + 1)): (size, order).

    Orders start at 1; beyond its own number of them, a size has zeros.

    Source: Bohren and Huffman (1983), eq. 4.88 and 4.89, and appendix A for the recurrences and the
    number of orders.
    """
    x = np.asarray(size_parameters, dtype=np.float64)
    m = complex(index.real, abs(index.imag))  # their sign of absorption
    needed = np.floor(x + 4.05 * np.cbrt(x) + 2.0).astype(np.int64)
    count = int(needed.max(initial=1))
    derivative = _logarithmic_derivative(np.asarray(m * x, dtype=np.complex128), count)
    a, b = np.zeros((2, len(x), count), dtype=np.complex128)
    psi_before, psi, chi_before, chi = np.cos(x), np.sin(x), -np.sin(x), np.cos(x)
    for n in range(1, count + 1):
        own = needed >= n  # the functions of the others would overflow
        factor = np.where(own, (2 * n - 1) / x, 0.0)
        psi_before, psi = psi, factor * psi - psi_before
        chi_before, chi = chi, factor * chi - chi_before
        xi_before, xi = psi_before - 1j * chi_before, psi - 1j * chi
        scale = (2.0 * n + 1.0) / (n * (n + 1.0))
        for out, ratio in ((a, derivative[n] / m), (b, derivative[n] * m)):
            bracket = ratio + n / x
            fraction = (bracket * psi - psi_before) / (bracket * xi - xi_before)
            out[:, n - 1] = np.where(own, scale * fraction, 0.0)
    return a, b


def _logarithmic_derivative(z: C128, count: int) -> C128:
    """Compute psi_n' / psi_n of z (size,), orders 0 to `count`: (order, size).

    The recurrence downwards forgets its start above |z|, and keeps its error below.
    """
    out = np.zeros((count + 1, len(z)), dtype=np.complex128)
    current = np.zeros(len(z), dtype=np.complex128)
    largest = max(float(count), float(np.abs(z).max(initial=0.0)))
    start = int(largest + 10.0 * np.cbrt(largest)) + 16
    for n in range(start, 0, -1):
        current = n / z - 1.0 / (current + n / z)
        if n <= count + 1:
            out[n - 1] = current
    return out


def _angular_functions(cosines: F64, count: int) -> tuple[F64, F64]:
    """Compute pi_n and tau_n (order, angle) for the orders 1 to `count`.

    Source: Bohren and Huffman (1983), eq. 4.47.
    """
    pi, tau = np.zeros((2, count, len(cosines)))
    before, pi[0] = np.zeros_like(cosines), 1.0
    for n in range(1, count + 1):
        tau[n - 1] = n * cosines * pi[n - 1] - (n + 1) * before
        if n < count:
            pi[n] = ((2 * n + 1) * cosines * pi[n - 1] - (n + 1) * before) / n
            before = pi[n - 1]
    return pi, tau


_PER_LOBE = 12  # angles for the narrowest lobe, of a width of wavelength / diameter
_NODES = 64  # most points across an aperture


class Scattering:
    """Differential cross-sections of spheres of one material in a fluid.

    Parameters
    ----------
    particle_index : complex index n - i k against vacuum.
    wavelength_nm : in vacuum.
    angles_rad : range of scattering angles that are expected, apertures included; tables grow where
        others occur, as for particles outside the volume.
    """

    def __init__(
        self,
        particle_index: complex,
        fluid_index: float,
        wavelength_nm: float,
        angles_rad: tuple[float, float],
    ) -> None:
        self._index = particle_index / fluid_index
        self._wavelength_mm = wavelength_nm * 1e-6 / fluid_index
        self._angles_rad = angles_rad
        self._octaves: dict[int, _Octave] = {}

    def cross_section(
        self, diameters_mm: F64, angles_rad: F64, half_angles_rad: F64, in_plane: F64
    ) -> F64:
        """Compute dC/dOmega (n,), mm2/sr, averaged over a round aperture.

        Parameters
        ----------
        diameters_mm : (n,) on the lattice of sizes.
        angles_rad : (n,) between the laser's direction and that to the aperture's middle; where
            light does not arrive, NaN, the cross-section is 0.
        half_angles_rad : (n,) of the aperture, seen from the particle in the fluid.
        in_plane : (n,) share of the laser's power that is polarised in the plane of scattering; .5
            for light that is not polarised.

        The aperture is averaged along the plane of scattering, across which the intensity is even:
        a disc's chords are the weights. Source: Bohren and Huffman (1983), section 4.4.
        """
        numbers, out = size_numbers(diameters_mm), np.zeros(len(diameters_mm))
        arrives = np.isfinite(angles_rad) & np.isfinite(half_angles_rad)
        octaves = numbers // PER_OCTAVE
        for octave in np.unique(octaves[arrives]).tolist():
            if octave not in self._octaves:
                largest = float(lattice_diameters_mm(np.array((octave + 1) * PER_OCTAVE)))
                step = min(self._wavelength_mm / largest, 1.0) / _PER_LOBE
                given = self._index, np.pi / self._wavelength_mm, self._angles_rad
                self._octaves[octave] = _Octave(octave, step, *given)
            chosen = np.flatnonzero(arrives & (octaves == octave))
            angles, half = angles_rad[chosen], half_angles_rad[chosen]
            table = self._octaves[octave]
            out[chosen] = table.average(numbers[chosen], angles, half, in_plane[chosen])
        return out * (self._wavelength_mm / (2.0 * np.pi)) ** 2

    def extinction_mm2(self, diameters_mm: F64) -> F64:
        """Compute extinction cross-sections (n,) of spheres."""
        sizes, which = np.unique(diameters_mm, return_inverse=True)
        efficiency = extinction_efficiency(self._index, np.pi * sizes / self._wavelength_mm)
        return np.asarray((efficiency * np.pi / 4.0 * sizes**2)[which])


class _Octave:
    """Intensities of the sizes of one octave that occur.

    They are tabulated at multiples of an angle's step.

    Attributes
    ----------
    rows : (size, angle, 2) |S1|^2 and |S2|^2.
    """

    def __init__(
        self,
        octave: int,
        step_rad: float,
        index: complex,
        wavenumber: float,  # which times a diameter is its size parameter
        reach_rad: tuple[float, float],
    ) -> None:
        self._lowest, self._step_rad, self._index = octave * PER_OCTAVE, step_rad, index
        self._wavenumber = wavenumber
        self._first, self._last = self._multiples(reach_rad)
        self._numbers: I64 = np.zeros(0, dtype=np.int64)  # of the rows
        self._places: I64 = np.full(PER_OCTAVE, -1)  # row of each size; -1: none yet
        self.rows = self._intensities(self._numbers, self._first, self._last)

    def average(self, numbers: I64, angles_rad: F64, half_rad: F64, in_plane: F64) -> F64:
        """Average |S|^2 (n,) over apertures.

        New sizes and angles are added to the table; what it holds stays as it is.
        """
        reach_rad = float((angles_rad - half_rad).min()), float((angles_rad + half_rad).max())
        first, last = self._multiples(reach_rad)
        if first < self._first:
            more = self._intensities(self._numbers, first, self._first - 1)
            self.rows, self._first = np.concatenate([more, self.rows], axis=1), first
        if last > self._last:
            more = self._intensities(self._numbers, self._last + 1, last)
            self.rows, self._last = np.concatenate([self.rows, more], axis=1), last
        own = np.unique(numbers[self._places[numbers - self._lowest] < 0])
        if len(own):
            more = self._intensities(own, self._first, self._last)
            self._places[own - self._lowest] = len(self.rows) + np.arange(len(own))
            self.rows = np.concatenate([self.rows, more])
            self._numbers = np.concatenate([self._numbers, own])
        places, out = self._places[numbers - self._lowest], np.empty(len(numbers))
        at, half = angles_rad / self._step_rad - self._first, half_rad / self._step_rad
        on_cores(_average, len(out), self.rows, places, at, half, in_plane, _nodes(), out)
        return out

    def _multiples(self, reach_rad: tuple[float, float]) -> tuple[int, int]:
        low, high = (reach / self._step_rad for reach in reach_rad)
        return math.floor(low) - 1, math.floor(high) + 2  # as cubic interpolation needs

    def _intensities(self, numbers: I64, first: int, last: int) -> F32:
        angles = self._step_rad * np.arange(first, last + 1, dtype=np.float64)
        sizes = self._wavenumber * lattice_diameters_mm(numbers)
        if not len(sizes):
            return np.zeros((0, len(angles), 2), dtype=np.float32)
        return np.stack(intensities(self._index, sizes, angles), axis=-1).astype(np.float32)


@functools.cache
def _nodes() -> tuple[F64, F64]:
    """Compute points across an aperture, and weights: (count, point) each.

    Gauss and Chebyshev's second rule: its weight is a disc's chord.
    """
    points, weights = np.zeros((2, _NODES + 1, _NODES))
    for count in range(1, _NODES + 1):
        turns = np.arange(1, count + 1) * np.pi / (count + 1)
        points[count, :count] = np.cos(turns)
        weights[count, :count] = np.sin(turns) ** 2 / (np.sin(turns) ** 2).sum()
    return points, weights


@numba.njit(cache=True, nogil=True)
def _average(
    jobs: slice, rows: Any, places: Any, at: Any, half: Any, in_plane: Any, nodes: Any, out: Any
) -> None:
    """Average cubic interpolations over apertures; `at` and `half` are in steps."""
    points, weights = nodes
    largest, last = points.shape[0] - 1, rows.shape[1] - 3
    for i in range(jobs.start, jobs.stop):
        count = min(int(0.3 * half[i]) + 5, largest)  # the lobes' phase needs half as many
        row, both = rows[places[i]], (1.0 - in_plane[i], in_plane[i])
        total = 0.0
        for k in range(count):
            position = at[i] + half[i] * points[count, k]
            cell = min(max(math.floor(position), 1), last)
            t = position - cell
            before, after = t + 1.0, t - 2.0
            w0, w1 = -t * (t - 1.0) * after / 6.0, before * (t - 1.0) * after / 2.0
            w2, w3 = -before * t * after / 2.0, before * t * (t - 1.0) / 6.0
            for p in range(2):
                value = w0 * row[cell - 1, p] + w1 * row[cell, p]
                value = value + w2 * row[cell + 1, p] + w3 * row[cell + 2, p]
                total += both[p] * weights[count, k] * value
        out[i] = max(total, 0.0)


class Scatterers:
    """Materials of a scene, and the material of each particle.

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
        return self._by_material(particles, Scattering.cross_section, angles, half, in_plane)

    def extinction_mm2(self, particles: Particles) -> F64:
        """Compute extinction cross-sections (n,)."""
        return self._by_material(particles, Scattering.extinction_mm2)

    def _by_material(self, particles: Particles, compute: Callable[..., F64], *given: F64) -> F64:
        numbers = material_numbers(self._tracer, self._seed, particles.id)
        out = np.empty(len(particles))
        for number, material in enumerate(self._materials):
            own = numbers == number
            some = (values[own] for values in (particles.diameter_mm, *given))
            out[own] = compute(material, *some)
        return out


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
        along = unit(light.direction)
        field = unit(light.polarisation)
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
    along = unit(scene.light.direction)
    place = particles.position_mm - np.asarray(scene.volume.center_mm)
    inside = (np.abs(place) <= size / 2.0).all(axis=1)
    path = np.zeros(len(place))  # to the faces of the volume, without what is outside
    for direction in (np.broadcast_to(-along, place.shape), -arriving):
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (np.copysign(size / 2.0, direction) - place) / direction
        distance = np.where(direction == 0.0, np.inf, distance)
        path += np.where(inside, distance.min(axis=1), 0.0)
    return np.asarray(np.exp(-per_mm * path))


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
    return np.asarray(np.arccos(np.clip(-arriving @ unit(direction), -1.0, 1.0)))
