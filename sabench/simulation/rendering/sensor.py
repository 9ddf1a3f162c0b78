"""Sensor: photons to electrons to grey values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F64, U16
from sabench.utils.errors import InputError

_HOT = 0.5  # of the full well: mean signal of hot pixels
_MOST_E = 1e15  # electrons: more than any well holds, and fewer than the Poisson generator refuses


def full_well_photons(sensor: Sensor) -> float:
    """Compute the mean number of photons that fill a pixel's well."""
    return sensor.full_well_e / sensor.quantum_efficiency


@dataclass(frozen=True)
class Pattern:
    """Differences between the pixels of one camera, the same in every frame.

    Attributes
    ----------
    response : (row, column) response to light, relative to the mean; 0 for dead pixels.
    hot_e : mean signal of hot pixels without light; 0 for others.
    offset_e : signal that each pixel adds, without noise; it may be negative.
    """

    response: F64
    hot_e: F64
    offset_e: F64


def make_pattern(sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> Pattern:
    """Draw the pattern of a camera's pixels (row, column).

    Responses and offsets are normal, signals of hot pixels exponential (EMVA 1288 release 4.0,
    sections 6 and 8: non-uniformities, defect pixels). All draws are made whatever the sensor has,
    so that a flaw does not depend on the others.
    """
    response = 1.0 + (sensor.prnu or 0.0) * rng.standard_normal(shape)
    offset = (sensor.dsnu_e or 0.0) * rng.standard_normal(shape)
    kind, size = rng.random(shape), rng.standard_exponential(shape)
    hot = kind < (sensor.hot_pixels or 0.0)
    dead = kind > 1.0 - (sensor.dead_pixels or 0.0)
    mean = sensor.hot_e or _HOT * sensor.full_well_e
    response, offset = np.where(dead, 0.0, np.maximum(response, 0.0)), np.where(dead, 0.0, offset)
    return Pattern(response, np.where(hot, mean * size, 0.0), offset)


def expose(
    sensor: Sensor, photons: F64, rng: np.random.Generator, pattern: Pattern | None = None
) -> U16:
    """Convert mean photons (rows, columns) to grey values, with noise.

    Electrons: Poisson (QE photons + dark current x exposure) if shot noise is on, its mean if not,
    clipped to the full well, plus Gaussian read noise; grey value: black level + gain x electrons,
    rounded, clipped to the bit depth (EMVA 1288's linear model). A pattern multiplies the mean
    light, adds the mean signal of hot pixels before, and offsets after the full well. With
    nonlinearity a, electrons e in the well W count as e (1 - a (e / W)^2).
    """
    mean = sensor.quantum_efficiency * photons
    if pattern is not None:
        mean = pattern.response * mean + pattern.hot_e
    mean += (
        sensor.dark_current_e_s
        * sensor.exposure_s
        * (1.0 if pattern is None else pattern.response > 0.0)
    )
    if not np.isfinite(mean).all():
        raise InputError(
            "illumination: photon counts must be finite, got inf or NaN; check the pulse energy "
            "and the lights"
        )
    np.minimum(mean, _MOST_E, out=mean)
    electrons = rng.poisson(mean).astype(np.float64) if sensor.shot_noise else mean
    np.minimum(electrons, sensor.full_well_e, out=electrons)
    if sensor.nonlinearity:
        electrons *= 1.0 - sensor.nonlinearity * (electrons / sensor.full_well_e) ** 2
    if pattern is not None:
        electrons += pattern.offset_e
    if sensor.read_noise_e > 0.0:
        electrons += sensor.read_noise_e * rng.standard_normal(photons.shape)
    electrons *= sensor.gain_dn_e
    electrons += sensor.black_level_dn
    np.rint(electrons, out=electrons)
    return np.clip(electrons, 0, (1 << sensor.bit_depth) - 1, out=electrons).astype(np.uint16)
