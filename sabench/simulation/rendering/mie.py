"""Mie scattering of particles, tabulated and averaged over an aperture."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d

from sabench.utils.arrays import C128, F64

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

    def averaged(self, half_angle_rad: float) -> MieTable:
        """Average the table over a round aperture of that half angle in the fluid.

        The weights are semicircular.
        """
        reach = int(np.floor(half_angle_rad / _STEP_RAD))
        weights = np.sqrt(
            1.0 - (np.arange(-reach, reach + 1) * _STEP_RAD / max(half_angle_rad, _STEP_RAD)) ** 2
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
    coefficients a_n, b_n from miepython.
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
    angles = np.arange(
        max(0.0, angles_rad[0] - 10 * _STEP_RAD),
        min(np.pi, angles_rad[1] + 10 * _STEP_RAD) + _STEP_RAD,
        _STEP_RAD,
    )
    wavenumber = 2.0 * np.pi * fluid_index / (wavelength_nm * 1e-6)
    series = [
        (size, count, *_coefficients(particle_index / fluid_index, wavenumber * size / 2.0))
        for size, count in sizes_mm
    ]
    functions = _angular_functions(np.cos(angles), max(len(a) for _, _, a, _ in series))
    total = np.zeros_like(angles)
    for size, count, a, b in series:
        strength = sum(np.abs(s) ** 2 for s in _amplitudes(a, b, *functions))
        total += count * strength / (2.0 * wavenumber**2 * size**2)
    return MieTable(angles, total / _SIZES)


def _coefficients(index: complex, size_parameter: float) -> tuple[C128, C128]:
    """Compute a_n and b_n (n,) of a sphere, from the order 1 on, by miepython."""
    import miepython

    lossy = np.conj(index) if np.imag(index) > 0 else index  # its sign of absorption
    a, b = miepython.an_bn(lossy, size_parameter, 0)
    return a, b


def _angular_functions(cosines: F64, count: int) -> tuple[F64, F64]:
    """Compute pi_n and tau_n (angle, order) for the orders 1 to `count`.

    Source: Bohren and Huffman (1983), eq. 4.47, for all angles at once: miepython takes one at a
    time, and repeats it for every size.
    """
    pi, tau = np.zeros((2, count, len(cosines)))
    before, pi[0] = np.zeros_like(cosines), 1.0
    for n in range(1, count + 1):
        tau[n - 1] = n * cosines * pi[n - 1] - (n + 1) * before
        if n < count:
            pi[n] = ((2 * n + 1) * cosines * pi[n - 1] - (n + 1) * before) / n
            before = pi[n - 1]
    return np.ascontiguousarray(pi.T), np.ascontiguousarray(tau.T)


def _amplitudes(a: C128, b: C128, pi: F64, tau: F64) -> tuple[C128, C128]:
    """Sum the series of S1 and S2 (angle,), up to the complex conjugate.

    Source: Bohren and Huffman (1983), eq. 4.74.
    """
    n = np.arange(1, len(a) + 1)
    scale = (2.0 * n + 1.0) / ((n + 1.0) * n)
    a, b = scale * a, scale * b
    pairs = list(zip(pi[:, : len(a)], tau[:, : len(a)], strict=True))
    first = np.array([np.dot(p, a) + np.dot(t, b) for p, t in pairs])
    second = np.array([np.dot(t, a) + np.dot(p, b) for p, t in pairs])
    return first, second
