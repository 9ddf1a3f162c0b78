"""Sensor: photons to electrons to grey values, with exact noise.

A pixel's random numbers come from separate Philox blocks with counters of its column and row, an
attempt, and a purpose. The first attempt's words are handed in; few numbers need others. Uniform
numbers have 53 bits.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sabench.scenes.sensor import Sensor
from sabench.utils.arrays import F64, U16
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.errors import InputError
from sabench.utils.philox import block, draw_key, fill_blocks
from sabench.utils.threads import on_cores

SHOT, READ, _REST = np.uint64(0), np.uint64(1), np.uint64(2)  # purposes of blocks
_ONE, _SHIFT, _UNUSED = np.uint64(1), np.uint64(21), np.uint64(11)
_LAYER, _SIGN = np.uint64(0xFF), np.uint64(0x100)  # of the bits that uniform numbers leave
_LAYERS, _EDGE = 256, 3.6541528853610088  # of the ziggurat, and where its tail begins
_LARGE = 10  # the least mean of which numbers are nearly normal
_PER_UNIT, _MOST = 8, 64  # tabulated means, and numbers of each


def _ziggurat() -> tuple[F64, F64]:
    """Compute the edges (257,) of layers of equal area, and exp(-x^2 / 2) there."""
    height, tail = math.exp(-0.5 * _EDGE**2), math.erfc(_EDGE / math.sqrt(2.0))
    area = _EDGE * height + math.sqrt(math.pi / 2.0) * tail
    edges = np.zeros(_LAYERS + 1)
    edges[0], edges[1] = area / height, _EDGE  # the lowest layer holds the tail
    for i in range(2, _LAYERS):
        height += area / edges[i - 1]
        edges[i] = math.sqrt(-2.0 * math.log(height))
    return edges, np.exp(-0.5 * edges**2)


def _distributions() -> F64:
    """Tabulate cumulative Poisson distributions (mean, number).

    The last column ends searches.
    """
    means = np.arange(_LARGE * _PER_UNIT)[:, None] / _PER_UNIT
    chances = np.ones((len(means), _MOST))
    chances[:, 1:] = means / np.arange(1, _MOST)
    table = np.cumsum(np.exp(-means) * np.cumprod(chances, axis=1), axis=1)
    table[:, -1] = np.inf
    return table


_EDGES, _HEIGHTS = _ziggurat()
_DISTRIBUTIONS = _distributions()


@numba.njit(cache=True, inline="always")
def _uniform(high: Any, low: Any) -> Any:
    """Make a number in [0, 1) of the upper 53 bits of two words."""
    return np.int64((high << _SHIFT) | (low >> _UNUSED)) * 2.0**-53


@inner_kernel()
def fill_normals(key: Any, row: Any, blocks: Any, numbers: Any) -> None:
    """Fill in standard normal numbers (column,) of a row for read noise.

    `blocks` (4, column) are the row's first blocks. Most numbers come from a loop without branches,
    for vector registers; it leaves the others as NaN.
    """
    for column in range(len(numbers)):
        x, below = _try_normal(np.uint64(blocks[0, column]), np.uint64(blocks[1, column]))
        numbers[column] = x if below else np.nan
    for column in range(len(numbers)):
        if np.isnan(numbers[column]):
            words = _words(blocks, column)
            numbers[column] = _normal(key, np.uint64(column), row, READ, words)


@inner_kernel()
def fill_poisson(key: Any, row: Any, blocks: Any, means: Any, numbers: Any) -> None:
    """Fill in Poisson numbers (column,) of a row for its means (column,).

    Means are at most 1e15. Works as `fill_normals` does.
    """
    for column in range(len(means)):  # 0 or a nearly normal number
        mean = means[column]
        w0, w1 = np.uint64(blocks[0, column]), np.uint64(blocks[1, column])
        x, below = _try_normal(w0, w1)
        k = np.floor(mean + math.sqrt(mean) * x)
        v = _uniform(np.uint64(blocks[2, column]), np.uint64(blocks[3, column]))
        short = mean - k
        quick = below and short * short * short <= 6.0 * mean * mean * v
        large = k if quick else np.nan
        small = 0.0 if mean * _PER_UNIT < 1.0 and _uniform(w0, w1) < 1.0 - mean else np.nan
        numbers[column] = large if mean >= _LARGE else small
    for column in range(len(means)):
        if np.isnan(numbers[column]):
            words = _words(blocks, column)
            numbers[column] = _poisson(key, np.uint64(column), row, words, means[column])


@inner_kernel()
def _words(blocks: Any, column: int) -> Any:
    return (
        np.uint64(blocks[0, column]),
        np.uint64(blocks[1, column]),
        np.uint64(blocks[2, column]),
        np.uint64(blocks[3, column]),
    )


@numba.njit(cache=True, inline="always")
def _try_normal(high: Any, low: Any) -> Any:
    """Draw a place in a layer of the ziggurat, and whether it is below the density.

    Source: Marsaglia and Tsang, J. Stat. Software 5, 8 (2000).
    """
    layer = np.uintp(low & _LAYER)
    x = _uniform(high, low) * _EDGES[layer]
    return x if low & _SIGN else -x, x < _EDGES[layer + _ONE]


@inner_kernel()
def _normal(key: Any, column: Any, row: Any, purpose: Any, words: Any) -> Any:
    """Draw a standard normal number; it takes the first two words.

    Other blocks decide where a layer is not wholly below the density. Source of the tail:
    G. Marsaglia, Technometrics 6, 101-102 (1964).
    """
    first, below = _try_normal(words[0], words[1])
    if below:
        return first
    layer, x, attempt = np.intp(words[1] & _LAYER), abs(first), np.uint64(0)
    while True:
        attempt += _ONE
        words = block(key, column, row, attempt, purpose)
        u = _uniform(words[2], words[3])
        if layer == 0:
            beyond = -math.log1p(-_uniform(words[0], words[1])) / _EDGE
            if -2.0 * math.log1p(-u) > beyond * beyond:
                return math.copysign(_EDGE + beyond, first)
            continue
        low, high = _HEIGHTS[layer], _HEIGHTS[layer + 1]
        if low + u * (high - low) < math.exp(-0.5 * x * x):
            return math.copysign(x, first)
        layer = np.intp(words[1] & _LAYER)
        x = _uniform(words[0], words[1]) * _EDGES[layer]
        if x < _EDGES[layer + 1]:
            return math.copysign(x, first)


@inner_kernel()
def _poisson(key: Any, column: Any, row: Any, words: Any, mean: float) -> Any:
    """Draw a Poisson number."""
    if mean >= _LARGE:
        return _near_normal(key, column, row, words, mean)
    u = _uniform(words[0], words[1])
    if mean * _PER_UNIT < 1.0:
        return _invert(u, mean)
    # from a tabulated distribution, and a number of the rest of the mean
    cell = np.uintp(np.intp(mean * _PER_UNIT))
    k = np.uintp(0)
    while u >= _DISTRIBUTIONS[cell, k]:
        k += _ONE
    return float(k) + _invert(_uniform(words[2], words[3]), mean - cell / _PER_UNIT)


@inner_kernel()
def _invert(u: float, mean: float) -> Any:
    """Find a small mean's first number with a cumulative probability above u."""
    if u < 1.0 - mean:  # which is less than exp(-mean)
        return 0.0
    k, chance = 0, math.exp(-mean)
    while u >= chance and k < _MOST:
        u -= chance
        k += 1
        chance *= mean / k
    return float(k)


# Ahrens and Dieter, ACM Trans. Math. Software 8, 163-179 (1982), algorithm PD, with its constants:
# a normal number, rounded down, is accepted with the ratio of Poisson's probability to its own,
# which is above 1 from a little below the mean on. In its place comes a number of where Poisson's
# probability is larger, drawn by rejection from a double exponential.


@inner_kernel()
def _near_normal(key: Any, column: Any, row: Any, words: Any, mean: float) -> Any:
    root = math.sqrt(mean)
    k = np.floor(mean + root * _normal(key, column, row, SHOT, words))
    u = _uniform(words[2], words[3])
    short = mean - k
    if short * short * short <= 6.0 * mean * mean * u or k >= np.floor(mean - 1.1484):
        return k
    if k >= 0.0 and (1.0 - u) * _normal_share(k, mean, root) <= _chance(k, mean):
        return k
    attempt = np.uint64(0)
    while True:
        words = block(key, column, row, attempt, _REST)
        attempt += _ONE
        away, u = -math.log1p(-_uniform(words[0], words[1])), _uniform(words[2], words[3])
        side = 2.0 * u - 1.0
        t = 1.8 + math.copysign(away, side)
        k = np.floor(mean + root * t)
        lacking = (_chance(k, mean) - _normal_share(k, mean, root)) if t > -0.6744 else 0.0
        if 0.1069 * abs(side) < lacking * mean * math.exp(away):
            return k


@inner_kernel()
def _normal_share(k: float, mean: float, root: float) -> Any:
    """Compute the share of a normal distribution from k to k + 1."""
    x, step = (k - mean) / (root * math.sqrt(2.0)), 1.0 / (root * math.sqrt(2.0))
    if x > 0.0:
        return 0.5 * (math.erfc(x) - math.erfc(x + step))
    return 0.5 * (math.erfc(-x - step) - math.erfc(-x))


@inner_kernel()
def _chance(k: float, mean: float) -> Any:
    """Compute the probability of a Poisson number, without cancellation.

    Source: C. Loader, "Fast and accurate computation of binomial probabilities" (2000).
    """
    if k == 0.0:
        return math.exp(-mean)
    if k < _LARGE:  # log k! - log(sqrt(2 pi k) (k / e)^k)
        error = math.lgamma(k + 1.0) - 0.5 * math.log(2.0 * math.pi * k) - k * math.log(k) + k
    else:  # Stirling's
        square = 1.0 / (k * k)
        series = 1.0 / 360.0 - square * (1.0 / 1260.0 - square / 1680.0)
        error = (1.0 / 12.0 - square * series) / k
    ratio = (k - mean) / (k + mean)  # of the deviance k log(k / mean) + mean - k
    if abs(ratio) > 0.1:
        deviance = k * math.log(k / mean) + mean - k
    else:
        deviance, term, n, before = (k - mean) * ratio, 2.0 * k * ratio, 1.0, np.inf
        while deviance != before:
            term, n = term * ratio * ratio, n + 2.0
            before, deviance = deviance, deviance + term / n
    return math.exp(-error - deviance) / math.sqrt(2.0 * math.pi * k)


_HOT = 0.5  # of the full well: mean signal of hot pixels
_MOST_E = 1e15  # electrons: more than any well holds, and few enough to be counted exactly


@dataclass(frozen=True)
class FixedPattern:
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


def make_pattern(sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> FixedPattern:
    """Draw the pattern of a camera's pixels (row, column).

    Responses and offsets are normal, signals of hot pixels exponential (EMVA 1288 release 4.0,
    sections 6 and 8: non-uniformities, defect pixels). All draws are made for any sensor, so that a
    flaw does not depend on the others.
    """
    response = 1.0 + (sensor.prnu or 0.0) * rng.standard_normal(shape)
    offset = (sensor.dsnu_e or 0.0) * rng.standard_normal(shape)
    kind, size = rng.random(shape), rng.standard_exponential(shape)
    hot = kind < (sensor.hot_pixels or 0.0)
    dead = kind > 1.0 - (sensor.dead_pixels or 0.0)
    mean = sensor.hot_e or _HOT * sensor.full_well_e
    response, offset = np.where(dead, 0.0, np.maximum(response, 0.0)), np.where(dead, 0.0, offset)
    return FixedPattern(response, np.where(hot, mean * size, 0.0), offset)


class _Chain(NamedTuple):
    """Parameters of a sensor for the kernel, in the order of the signal path."""

    quantum_efficiency: float
    dark_e: float
    shot_noise: bool
    full_well_e: float
    nonlinearity: float
    read_noise_e: float
    gain_dn_e: float
    black_level_dn: float
    most_dn: float


def expose(
    sensor: Sensor, photons: F64, rng: np.random.Generator, pattern: FixedPattern | None = None
) -> U16:
    """Convert mean photons (rows, columns) to grey values, with noise.

    Electrons: Poisson (QE photons + dark current x exposure) if shot noise is on, its mean if not,
    clipped to the full well, plus Gaussian read noise; grey value: black level + gain x electrons,
    rounded, clipped to the bit depth (EMVA 1288's linear model). A pattern multiplies the mean
    light, adds the mean signal of hot pixels before, and offsets after the full well. With
    nonlinearity a, electrons e in the well W count as e (1 - a (e / W)^2).

    `rng` gives the key of the noise; each pixel has separate random numbers: the same for any
    number of threads.
    """
    pixels = None if pattern is None else (pattern.response, pattern.hot_e, pattern.offset_e)
    chain = _Chain(
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
    light, grey = np.ascontiguousarray(photons), np.empty(photons.shape, dtype=np.uint16)
    if any(on_cores(_expose, len(light), light, pixels, draw_key(rng), chain, grey)):
        raise InputError(
            "illumination: photon counts must be finite and not negative; check the pulse energy "
            "and the lights"
        )
    return grey


@numba.njit(cache=True, nogil=True)
def _expose(jobs: slice, photons: Any, pixels: Any, key: Any, chain: Any, grey: Any) -> Any:
    """Fill in rows of grey values; return how many pixels have no possible mean."""
    columns, wrong, start = photons.shape[1], 0, np.uint64(0)
    means, signal, noise = np.empty(columns), np.empty(columns), np.zeros(columns)
    blocks = np.empty((4, columns), np.uint32)
    for row in range(jobs.start, jobs.stop):
        counter = np.uint64(row)
        for column in range(columns):
            mean = chain.quantum_efficiency * photons[row, column]
            if pixels is None:
                mean += chain.dark_e
            else:
                mean = pixels[0][row, column] * mean + pixels[1][row, column]
                mean += chain.dark_e * (pixels[0][row, column] > 0.0)
            wrong += not 0.0 <= mean < np.inf
            means[column] = min(mean, _MOST_E)
        if chain.shot_noise and wrong == 0:
            fill_blocks(key, start, counter, start, SHOT, blocks)
            fill_poisson(key, counter, blocks, means, signal)
        else:
            for column in range(columns):  # compiles 2 s faster than `signal[:] = means`
                signal[column] = means[column]
        if chain.read_noise_e > 0.0:
            fill_blocks(key, start, counter, start, READ, blocks)
            fill_normals(key, counter, blocks, noise)
        for column in range(columns):
            value = min(signal[column], chain.full_well_e)
            if chain.nonlinearity > 0.0:
                value *= 1.0 - chain.nonlinearity * (value / chain.full_well_e) ** 2
            if pixels is not None:
                value += pixels[2][row, column]
            value += chain.read_noise_e * noise[column]
            value = np.rint(value * chain.gain_dn_e + chain.black_level_dn)
            grey[row, column] = np.uint16(min(max(value, 0.0), chain.most_dn))
    return wrong
