"""Sensor: photons to electrons to grey values."""

from __future__ import annotations

import numpy as np

from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F64, U16
from sabench.utils.errors import InputError

_MOST_E = 1e15  # electrons: more than any well holds, and fewer than the Poisson generator refuses


def full_well_photons(sensor: Sensor) -> float:
    """Compute the mean number of photons that fill a pixel's well."""
    return sensor.full_well_e / sensor.quantum_efficiency


def expose(sensor: Sensor, photons: F64, rng: np.random.Generator) -> U16:
    """Convert mean photons (rows, columns) to grey values, with noise.

    Electrons: Poisson (QE photons + dark current x exposure) if shot noise is on, its mean if not,
    plus Gaussian read noise, clipped to the full well before the read noise; grey value: black
    level + gain x electrons, rounded, clipped to the bit depth (EMVA 1288's linear model).
    """
    mean = sensor.quantum_efficiency * photons
    mean += sensor.dark_current_e_s * sensor.exposure_s
    if not np.isfinite(mean).all():
        raise InputError(
            "illumination: photon counts must be finite, got inf or NaN; check the pulse energy "
            "and the lights"
        )
    np.minimum(mean, _MOST_E, out=mean)
    electrons = rng.poisson(mean).astype(np.float64) if sensor.shot_noise else mean
    np.minimum(electrons, sensor.full_well_e, out=electrons)
    if sensor.read_noise_e > 0.0:
        electrons += sensor.read_noise_e * rng.standard_normal(photons.shape)
    electrons *= sensor.gain_dn_e
    electrons += sensor.black_level_dn
    np.rint(electrons, out=electrons)
    return np.clip(electrons, 0, (1 << sensor.bit_depth) - 1, out=electrons).astype(np.uint16)
