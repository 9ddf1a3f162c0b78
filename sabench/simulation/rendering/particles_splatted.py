"""Analytic renderer: Gaussian particle images, integrated over each pixel.

They are ellipses, whose axes may lie at any angle to the pixels. By Mehler's expansion (J. reine
angew. Math. 66, 161-176, 1866) the integral of a Gaussian with the correlation r over a pixel is a
series in r whose terms are products of a column's and a row's factor, so that a window is a sum of
few outer products.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.geometry.camera import Camera
from sabench.images.gaussians import fill_shares
from sabench.simulation.rendering.particle_images import ParticleImages
from sabench.utils.arrays import F64

# standard deviations from the centre to the window's edge: less than 2e-5 of the light is left out
_REACH = 4.5
_SHARPEST = 1e-9  # px: anything sharper illuminates a single pixel as well
_EXACT = 1e-9  # of a particle's light in any pixel: terms below are left out
_LARGEST_TERM = 0.25  # bounds the product of both factors of a term
_LONGEST = 0.999  # correlation beyond which an ellipse is taken for one that narrow
_BAND = 64  # rows of a band, at least: threads fill bands that do not touch
_LANES = 4  # pixels of a row that are added at once
_ANY_ORDER = {"contract", "nsz"}


def render(camera: Camera, images: ParticleImages) -> F64:
    """Render photons (rows, columns) of one exposure.

    Light outside a particle's window of `_REACH` standard deviations is left out. Particles whose
    centre lies outside the sensor still illuminate the pixels that their window reaches. Pixels are
    exact to 2e-8 of each particle's light, and the same for any number of threads.
    """
    given = images.pixel, images.photons, images.spread_px2
    lit, half, widest = _find_lit(*given, camera.rows, camera.columns)
    margin, edge = 2 * widest + 1 + _LANES, max(_BAND, 2 * widest + 1)
    framed = np.zeros((camera.rows + 2 * margin, camera.columns + 2 * margin))
    bands = -(-len(framed) // edge)
    starts, *windows = _sort_windows(*given, lit, half, margin, edge, bands)
    _add_windows(framed, starts, *windows)
    image = np.empty((camera.rows, camera.columns))
    _crop(framed, margin, image)
    return image


@numba.njit(cache=True)
def _find_lit(pixel: Any, photons: Any, spread: Any, rows: int, columns: int) -> Any:
    """Find particles that illuminate an image.

    Returns their numbers (m,), half the widths and heights (m, 2) of their windows, and the largest
    of these.
    """
    lit, halves = np.empty(len(pixel), np.int64), np.empty((len(pixel), 2), np.int64)
    count, widest, size = 0, 0, (columns, rows)
    for i in range(len(pixel)):
        reached = photons[i] > 0.0
        for axis in range(2):
            half = np.ceil(_REACH * math.sqrt(spread[i, axis]) + 0.5)
            near = abs(pixel[i, axis] - (size[axis] - 1) / 2.0)
            reached = reached and near < half + size[axis] / 2.0
            halves[count, axis] = np.int64(half) if reached else 0
        if reached:
            widest = max(widest, halves[count, 0], halves[count, 1])
            lit[count] = i
            count += 1
    return lit[:count], halves[:count], widest


@numba.njit(cache=True)
def _sort_windows(
    pixel: Any,
    photons: Any,
    spread: Any,
    lit: Any,
    halves: Any,
    margin: int,
    edge: int,
    bands: int,
) -> Any:
    """Sort particles by the band of rows that they lie in.

    Returns where each band's start, and their pixels in the frame, photons, widths, correlations
    and half windows.
    """
    band = np.empty(len(lit), np.int64)
    starts, place = np.zeros(bands + 1, np.int64), np.zeros(bands, np.int64)
    for n in range(len(lit)):
        band[n] = np.int64(np.rint(pixel[lit[n], 1] + margin)) // edge
        starts[band[n] + 1] += 1
    for b in range(bands):
        place[b] = starts[b]
        starts[b + 1] += starts[b]
    where, sigma = np.empty((len(lit), 2)), np.empty((len(lit), 2))
    light, tilt, half = np.empty(len(lit)), np.empty(len(lit)), np.empty_like(halves)
    for n in range(len(lit)):
        i, to = lit[n], place[band[n]]
        place[band[n]] += 1
        for axis in range(2):
            where[to, axis] = pixel[i, axis] + margin
            sigma[to, axis] = max(math.sqrt(spread[i, axis]), _SHARPEST)
            half[to, axis] = halves[n, axis]
        light[to] = photons[i]
        slant = spread[i, 2] / (sigma[to, 0] * sigma[to, 1])
        tilt[to] = min(max(slant, -_LONGEST), _LONGEST)
    return starts, where, light, sigma, tilt, half


@numba.njit(cache=True, parallel=True)
def _crop(framed: Any, margin: int, image: Any) -> None:
    """Fill in an image without its frame.

    Series and table may end a little below zero, which no number of photons is.
    """
    for row in numba.prange(len(image)):
        for column in range(image.shape[1]):
            image[row, column] = max(framed[margin + row, margin + column], 0.0)


@numba.njit(cache=True, parallel=True)
def _add_windows(
    image: Any, starts: Any, pixel: Any, photons: Any, sigma: Any, tilt: Any, half: Any
) -> None:
    """Add the windows of 2 half + 1 pixels: even bands first, then odd."""
    bands = len(starts) - 1
    for odd in range(2):
        for turn in numba.prange((bands + 1 - odd) // 2):
            band = 2 * turn + odd
            _add_band(image, starts[band], starts[band + 1], pixel, photons, sigma, tilt, half)


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def _add_band(
    image: Any, first: int, last: int, pixel: Any, photons: Any, sigma: Any, tilt: Any, half: Any
) -> None:
    """Add the windows of some particles to an image with margins."""
    if first == last:
        return
    most = 2 * half[first:last].max() + 2 + _LANES
    all_terms = _count_terms(np.abs(tilt[first:last]).max())
    across, down = np.zeros((all_terms, most)), np.zeros((all_terms, most))
    edges = np.zeros((3, most))
    for i in range(first, last):
        left = int(np.rint(pixel[i, 0])) - half[i, 0]
        top = int(np.rint(pixel[i, 1])) - half[i, 1]
        width, height = 2 * half[i, 0] + 1, 2 * half[i, 1] + 1
        fill_shares(pixel[i, 0], sigma[i, 0], left, across[0, :width])
        fill_shares(pixel[i, 1], sigma[i, 1], top, down[0, :height])
        terms = _count_terms(tilt[i])
        if terms > 1:
            _fill_terms(pixel[i, 0], sigma[i, 0], left, width, terms, edges, across)
            _fill_terms(pixel[i, 1], sigma[i, 1], top, height, terms, edges, down)
        light = photons[i]
        for n in range(terms):
            across[n, width : width + _LANES] = 0.0
            weight = light if n == 0 else light / n
            for j in range(height):
                down[n, j] *= weight
            light *= tilt[i]
        _add_products(image, top, left, down, across, terms, height, width)


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def _add_products(
    image: Any, top: int, left: int, down: Any, across: Any, terms: int, height: int, width: int
) -> None:
    """Add a sum of outer products.

    Columns are zero up to a whole number of lanes.
    """
    start = np.uintp(left)
    for j in range(height):
        row = np.uintp(top + j)
        for block in range((width + _LANES - 1) // _LANES):
            k = np.uintp(block * _LANES)
            a = b = c = d = 0.0
            for n in range(terms):
                share = down[n, j]
                a += share * across[n, k]
                b += share * across[n, k + np.uintp(1)]
                c += share * across[n, k + np.uintp(2)]
                d += share * across[n, k + np.uintp(3)]
            image[row, start + k] += a
            image[row, start + k + np.uintp(1)] += b
            image[row, start + k + np.uintp(2)] += c
            image[row, start + k + np.uintp(3)] += d


# The n-th term is r^n / n times the difference of h between both edges of a column, times that of a
# row: h is the normal density times Hermite's polynomial of order n - 1, over the root of (n - 1)!.


@numba.njit(cache=True)
def _count_terms(tilt: float) -> int:
    """Count the terms of a series, with the one that has no correlation."""
    power, n = abs(tilt) * _LARGEST_TERM, 1
    while power > _EXACT * n:
        power, n = power * abs(tilt), n + 1
    return n


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def _fill_terms(
    center: float, sigma: float, first: int, size: int, terms: int, edges: Any, factors: Any
) -> None:
    """Fill in the factors (term, pixel) of all terms but the first.

    `edges` (3, ...) is for edges in standard deviations, h, and h of the order before.
    """
    z, h, older = edges[0], edges[1], edges[2]
    _fill_density(center, sigma, first, size + 1, z, h)
    older[: size + 1] = 0.0
    for n in range(1, terms):
        before, over = math.sqrt(n - 1.0), 1.0 / math.sqrt(float(n))
        for i in range(size):
            factors[n, i] = h[i] - h[i + 1]
        for i in range(size + 1 if n + 1 < terms else 0):
            higher = (z[i] * h[i] - before * older[i]) * over
            older[i], h[i] = h[i], higher


@numba.njit(cache=True)
def _fill_density(center: float, sigma: float, first: int, size: int, z: Any, h: Any) -> None:
    """Fill in equally spaced numbers and their normal density.

    It goes outwards from the middle: densities have ratios with a constant ratio, all at most one,
    so that none overflows.
    """
    step, middle = 1.0 / sigma, min(max(int(np.rint(center + 0.5)) - first, 0), size - 1)
    for i in range(size):
        z[i] = (first + i - 0.5 - center) * step
    change = math.exp(-step * step)
    for way in (1, -1):
        density = math.exp(-0.5 * z[middle] * z[middle]) / math.sqrt(2.0 * math.pi)
        ratio = math.exp(-step * (way * z[middle] + 0.5 * step))
        i = middle
        while 0 <= i < size:
            h[i] = density
            density, ratio, i = density * ratio, ratio * change, i + way
