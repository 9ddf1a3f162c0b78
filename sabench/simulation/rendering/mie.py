"""Mie scattering of particles, tabulated and averaged over an aperture."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d

from sabench.utils.arrays import F64

_STEP_RAD = np.deg2rad(
    0.02
    # resolves the lobes of particles up to about 0.5 mm in water (lobe width ~ wavelength /
    # diameter)
)
_SIZES = 16


@dataclass(frozen=True)
class MieTable:
    """Differential cross-section per squared diameter over scattering angles.

    In 1/sr; angles in rad, ascending.

    A polydisperse cloud is tabulated as the mean over `_SIZES` quantiles of its diameters: the
    lobes of single sizes, which depend on the diameter's last nanometre, average out in it as they
    do in an experiment; each particle then scales with its d^2.
    """

    angles_rad: F64
    per_square_diameter: F64

    def average(self, half_angle_rad: float) -> MieTable:
        """Average the table over a round aperture of that half angle in the fluid.

        The weights are semicircular.
        """
        steps = int(np.floor(half_angle_rad / _STEP_RAD))
        weights = np.sqrt(
            1.0 - (np.arange(-steps, steps + 1) * _STEP_RAD / max(half_angle_rad, _STEP_RAD)) ** 2
        )
        return MieTable(
            self.angles_rad,
            convolve1d(self.per_square_diameter, weights / weights.sum(), mode="nearest"),
        )

    def cross_section(self, angles_rad: F64, diameters_mm: F64) -> F64:
        """Compute dC/dOmega in mm2/sr at scattering angles (n,) of particles (n,)."""
        return np.interp(angles_rad, self.angles_rad, self.per_square_diameter) * diameters_mm**2


def mie_table(
    diameters_mm: F64,
    particle_index: complex,
    fluid_index: float,
    wavelength_nm: float,
    angles_rad: tuple[float, float],
) -> MieTable:
    """Tabulate unpolarised scattering of a cloud between two scattering angles.

    Parameters
    ----------
    diameters_mm : (n,) the cloud's diameters.
    particle_index : complex index n - i k of the particles, against vacuum.
    wavelength_nm : in vacuum.

    Source: dC/dOmega = (|S1|^2 + |S2|^2) / (2 k^2), Bohren and Huffman (1983), section 4.4;
    amplitudes from miepython, whose norm "wiscombe" is theirs (its "bohren" is twice that).
    """
    sizes, counts = np.unique(
        np.quantile(diameters_mm, (np.arange(_SIZES) + 0.5) / _SIZES), return_counts=True
    )
    return _tabulate(
        tuple(zip(sizes.tolist(), counts.tolist(), strict=True)),
        particle_index,
        fluid_index,
        wavelength_nm,
        angles_rad,
    )


@functools.lru_cache(maxsize=8)
def _tabulate(
    sizes_mm: tuple[tuple[float, int], ...],
    particle_index: complex,
    fluid_index: float,
    wavelength_nm: float,
    angles_rad: tuple[float, float],
) -> MieTable:
    """Tabulate sizes with how many of the cloud's `_SIZES` quantiles have each.

    The table is cached, since the frames of a moving cloud share it.
    """
    import miepython

    angles = np.arange(
        max(0.0, angles_rad[0] - 10 * _STEP_RAD),
        min(np.pi, angles_rad[1] + 10 * _STEP_RAD) + _STEP_RAD,
        _STEP_RAD,
    )
    wavenumber = 2.0 * np.pi * fluid_index / (wavelength_nm * 1e-6)
    total = np.zeros_like(angles)
    for size, count in sizes_mm:
        amplitudes = miepython.S1_S2(
            particle_index / fluid_index, wavenumber * size / 2.0, np.cos(angles), norm="wiscombe"
        )
        total += count * sum(np.abs(a) ** 2 for a in amplitudes) / (2.0 * wavenumber**2 * size**2)
    return MieTable(angles, total / _SIZES)
