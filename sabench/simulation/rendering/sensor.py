"""Sensor: photons to electrons to grey values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sabench.scenes.sensor import Sensor
from sabench.simulation.rendering.noise import READ, SHOT, fill_normals, fill_poisson
from sabench.utils.arrays import F64, U16
from sabench.utils.compiled import numba
from sabench.utils.errors import InputError
from sabench.utils.philox import draw_key, fill_blocks

_HOT = 0.5  # of the full well: mean signal of hot pixels
_ROWS = 16  # of a part of an image
_MOST_E = 1e15  # electrons: more than any well holds, and few enough to be counted exactly


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

    `rng` gives the key of the noise, in which each pixel has numbers of its own: the same for any
    number of threads.
    """
    pixels = None if pattern is None else (pattern.response, pattern.hot_e, pattern.offset_e)
    light, grey = np.ascontiguousarray(photons), np.empty(photons.shape, dtype=np.uint16)
    if _expose(light, pixels, draw_key(rng), _chain(sensor), grey):
        raise InputError(
            "illumination: photon counts must be finite and not negative; check the pulse energy "
            "and the lights"
        )
    return grey


class _Chain(NamedTuple):
    """Figures of a sensor for the kernel, in the order in which a signal meets them."""

    quantum_efficiency: float
    dark_e: float
    shot_noise: bool
    full_well_e: float
    nonlinearity: float
    read_noise_e: float
    gain_dn_e: float
    black_level_dn: float
    most_dn: float


def _chain(sensor: Sensor) -> _Chain:
    return _Chain(
        sensor.quantum_efficiency,
        sensor.dark_current_e_s * sensor.exposure_s,
        sensor.shot_noise,
        sensor.full_well_e,
        sensor.nonlinearity or 0.0,
        sensor.read_noise_e,
        sensor.gain_dn_e,
        sensor.black_level_dn,
        float((1 << sensor.bit_depth) - 1),
    )


@numba.njit(cache=True, parallel=True)
def _expose(photons: Any, pixels: Any, key: Any, chain: Any, grey: Any) -> Any:
    """Fill in grey values; return how many pixels have no possible mean."""
    wrong, rows = 0, len(photons)
    for part in numba.prange((rows + _ROWS - 1) // _ROWS):
        first = part * _ROWS
        wrong += _expose_rows(photons, pixels, key, chain, first, min(first + _ROWS, rows), grey)
    return wrong


@numba.njit(cache=True)
def _expose_rows(
    photons: Any, pixels: Any, key: Any, chain: Any, first: int, last: int, grey: Any
) -> Any:
    columns, wrong, start = photons.shape[1], 0, np.uint64(0)
    means, signal, noise = np.empty(columns), np.empty(columns), np.zeros(columns)
    blocks = np.empty((4, columns), np.uint32)
    for row in range(first, last):
        counter = np.uint64(row)
        wrong += _fill_means(photons, pixels, chain, row, means)
        if chain.shot_noise and wrong == 0:
            fill_blocks(key, start, counter, start, SHOT, blocks)
            fill_poisson(key, counter, blocks, means, signal)
        else:
            for column in range(columns):  # compiles 2 s faster than `signal[:] = means`
                signal[column] = means[column]
        if chain.read_noise_e > 0.0:
            fill_blocks(key, start, counter, start, READ, blocks)
            fill_normals(key, counter, blocks, noise)
        _fill_grey(signal, noise, pixels, chain, row, grey)
    return wrong


@numba.njit(cache=True)
def _fill_means(photons: Any, pixels: Any, chain: Any, row: Any, means: Any) -> Any:
    wrong = 0
    for column in range(len(means)):
        mean = chain.quantum_efficiency * photons[row, column]
        if pixels is None:
            mean += chain.dark_e
        else:
            mean = pixels[0][row, column] * mean + pixels[1][row, column]
            mean += chain.dark_e * (pixels[0][row, column] > 0.0)
        wrong += not 0.0 <= mean < np.inf
        means[column] = min(mean, _MOST_E)
    return wrong


@numba.njit(cache=True)
def _fill_grey(signal: Any, noise: Any, pixels: Any, chain: Any, row: Any, grey: Any) -> None:
    for column in range(len(signal)):
        value = min(signal[column], chain.full_well_e)
        if chain.nonlinearity > 0.0:
            value *= 1.0 - chain.nonlinearity * (value / chain.full_well_e) ** 2
        if pixels is not None:
            value += pixels[2][row, column]
        value += chain.read_noise_e * noise[column]
        value = np.rint(value * chain.gain_dn_e + chain.black_level_dn)
        grey[row, column] = np.uint16(min(max(value, 0.0), chain.most_dn))
