"""Laser sheet: photons per square millimetre of one pulse."""

from __future__ import annotations

import numpy as np

from sabench.scenes.illumination import Illumination
from sabench.utils.arrays import F64

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0


def photon_energy_mj(wavelength_nm: float) -> float:
    """Compute the energy of one photon, mJ."""
    return PLANCK_J_S * LIGHT_M_S / (wavelength_nm * 1e-9) * 1e3


def fluence(light: Illumination, center_mm: F64, positions_mm: F64) -> F64:
    """Compute photons per mm2 of one pulse at positions (n, 3) in a sheet.

    Top-hat: the energy evenly over height x thickness, zero outside the thickness. Gaussian: across
    the sheet exp(-8 s^2 / w^2) with the e^-2 width w, and the same energy. Along the height the
    sheet is even and wider than the volume.
    """
    normal = np.asarray(light.sheet_normal) / np.linalg.norm(light.sheet_normal)
    offset = (positions_mm - center_mm) @ normal - (light.shift_mm or 0.0)
    density = light.pulse_energy_mj / photon_energy_mj(light.wavelength_nm) / light.height_mm
    if light.profile == "top-hat":
        return np.where(
            np.abs(offset) <= light.thickness_mm / 2.0, density / light.thickness_mm, 0.0
        )
    width = light.thickness_mm
    return np.asarray(density * np.exp(-8.0 * (offset / width) ** 2) * np.sqrt(8.0 / np.pi) / width)
