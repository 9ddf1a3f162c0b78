"""Light that single particles scatter through a lens, from their own Mie series.

The scattering of one size is tabulated over angles where a particle of that size occurs. Sizes lie
on a lattice (`worlds.library.size_lattice`), so that a particle's brightness is that of its own
diameter, whatever else is in the frame.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from sabench.simulation.rendering.mie import extinction_efficiency, intensities
from sabench.utils.arrays import F32, F64, I64
from sabench.utils.compiled import numba
from sabench.worlds.library.size_lattice import PER_OCTAVE, lattice_diameters_mm, size_numbers

_PER_LOBE = 12  # angles for the narrowest lobe, of a width of wavelength / diameter
_MARGIN = 3  # angles beyond the range
_NODES = 64  # most points across an aperture
_NONE = -100  # stands for no octave, below all that occur


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
        octaves = np.where(arrives, numbers // PER_OCTAVE, _NONE)
        for octave in np.flatnonzero(np.bincount(octaves - _NONE)[1:]) + 1 + _NONE:
            chosen = np.flatnonzero(octaves == octave)
            angles, half = angles_rad[chosen], half_angles_rad[chosen]
            reach = float((angles - half).min()), float((angles + half).max())
            table = self._octave(int(octave), numbers[chosen], reach)
            out[chosen] = table.average(numbers[chosen], angles, half, in_plane[chosen])
        return out * (self._wavelength_mm / (2.0 * np.pi)) ** 2

    @property
    def size_mb(self) -> float:
        """Memory of the tables, 10^6 bytes."""
        return sum(table.rows.nbytes for table in self._octaves.values()) / 1e6

    def extinction_mm2(self, diameters_mm: F64) -> F64:
        """Compute extinction cross-sections (n,) of spheres."""
        sizes, which = np.unique(diameters_mm, return_inverse=True)
        efficiency = extinction_efficiency(self._index, np.pi * sizes / self._wavelength_mm)
        return np.asarray((efficiency * np.pi / 4.0 * sizes**2)[which])

    def _octave(self, octave: int, numbers: I64, reach_rad: tuple[float, float]) -> _Octave:
        """Return the table of an octave of sizes that holds given ones over given angles."""
        if octave not in self._octaves:
            largest = float(lattice_diameters_mm(np.array((octave + 1) * PER_OCTAVE)))
            step = min(self._wavelength_mm / largest, 1.0) / _PER_LOBE
            wavenumber = np.pi / self._wavelength_mm
            self._octaves[octave] = _Octave(octave, step, self._index, wavenumber, self._angles_rad)
        table = self._octaves[octave]
        table.widen(reach_rad)
        table.add(numbers)
        return table


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
        self._octave, self._step_rad, self._index = octave, step_rad, index
        self._wavenumber = wavenumber
        self._first, self._last = self._multiples(reach_rad)
        self._numbers: I64 = np.zeros(0, dtype=np.int64)  # of the rows
        self._places: I64 = np.full(PER_OCTAVE, -1)  # row of each size; -1: none yet
        self.rows = self._intensities(self._numbers, self._first, self._last)

    def widen(self, reach_rad: tuple[float, float]) -> None:
        """Extend the table to more angles; what it holds stays as it is."""
        first, last = self._multiples(reach_rad)
        if first < self._first:
            more = self._intensities(self._numbers, first, self._first - 1)
            self.rows, self._first = np.concatenate([more, self.rows], axis=1), first
        if last > self._last:
            more = self._intensities(self._numbers, self._last + 1, last)
            self.rows, self._last = np.concatenate([self.rows, more], axis=1), last

    def add(self, numbers: I64) -> None:
        """Tabulate new sizes."""
        own = np.unique(numbers[self._places[numbers - self._octave * PER_OCTAVE] < 0])
        if len(own):
            more = self._intensities(own, self._first, self._last)
            self._places[own - self._octave * PER_OCTAVE] = len(self.rows) + np.arange(len(own))
            self.rows = np.concatenate([self.rows, more])
            self._numbers = np.concatenate([self._numbers, own])

    def _multiples(self, reach_rad: tuple[float, float]) -> tuple[int, int]:
        low, high = reach_rad
        return (
            math.floor(low / self._step_rad) - _MARGIN,
            math.ceil(high / self._step_rad) + _MARGIN,
        )

    def _intensities(self, numbers: I64, first: int, last: int) -> F32:
        angles = self._step_rad * np.arange(first, last + 1, dtype=np.float64)
        sizes = self._wavenumber * lattice_diameters_mm(numbers)
        if not len(sizes):
            return np.zeros((0, len(angles), 2), dtype=np.float32)
        return np.stack(intensities(self._index, sizes, angles), axis=-1).astype(np.float32)

    def average(self, numbers: I64, angles_rad: F64, half_rad: F64, in_plane: F64) -> F64:
        """Average |S|^2 (n,) over apertures."""
        places = self._places[numbers - self._octave * PER_OCTAVE]
        out = np.empty(len(numbers))
        at, half = angles_rad / self._step_rad - self._first, half_rad / self._step_rad
        _average(self.rows, places, at, half, in_plane, *_nodes(), out)
        return out


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


@numba.njit(cache=True, parallel=True)
def _average(
    rows: Any, places: Any, at: Any, half: Any, in_plane: Any, points: Any, weights: Any, out: Any
) -> None:
    """Average cubic interpolations over apertures; `at` and `half` are in steps."""
    largest, last = points.shape[0] - 1, rows.shape[1] - 3
    for i in numba.prange(len(places)):
        count = min(int(0.3 * half[i]) + 5, largest)  # the lobes' phase needs half as many
        row, both = places[i], (1.0 - in_plane[i], in_plane[i])
        total = 0.0
        for k in range(count):
            position = at[i] + half[i] * points[count, k]
            cell = min(max(math.floor(position), 1), last)
            t = position - cell
            before, after = t + 1.0, t - 2.0
            w0, w1 = -t * (t - 1.0) * after / 6.0, before * (t - 1.0) * after / 2.0
            w2, w3 = -before * t * after / 2.0, before * t * (t - 1.0) / 6.0
            for p in range(2):
                value = (
                    w0 * rows[row, cell - 1, p]
                    + w1 * rows[row, cell, p]
                    + w2 * rows[row, cell + 1, p]
                    + w3 * rows[row, cell + 2, p]
                )
                total += both[p] * weights[count, k] * value
        out[i] = max(total, 0.0)
