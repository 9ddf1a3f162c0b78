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
from sabench.utils.arrays import F64, I64

# standard deviations from the centre to the window's edge: less than 2e-5 of the light is left out
_REACH = 4.5
_SHARPEST = 1e-9  # px: anything sharper illuminates a single pixel as well
_EXACT = 1e-9  # of a particle's light in any pixel: terms below are left out
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
    shape = camera.rows, camera.columns
    sigma = np.sqrt(images.spread_px2[:, :2])
    half = np.ceil(_REACH * sigma + 0.5)
    near = np.abs(images.pixel - np.array([shape[1] - 1, shape[0] - 1]) / 2.0)
    reached = (near < half + np.array([shape[1], shape[0]]) / 2.0).all(axis=1)
    lit = np.flatnonzero((images.photons > 0.0) & reached)
    sigma, size = np.maximum(sigma[lit], _SHARPEST), half[lit].astype(np.int64)
    tilt = np.clip(images.spread_px2[lit, 2] / sigma.prod(axis=1), -_LONGEST, _LONGEST)
    widest = int(size.max(initial=0))
    margin = 2 * widest + 1 + _LANES
    framed = np.zeros((shape[0] + 2 * margin, shape[1] + 2 * margin))
    pixel, edge = images.pixel[lit] + margin, max(_BAND, 2 * widest + 1)
    order, starts = _bands(pixel[:, 1], edge, len(framed))
    pixel, photons = pixel[order], images.photons[lit[order]]
    _add_windows(framed, starts, pixel, photons, sigma[order], tilt[order], size[order])
    # series and table may end a little below zero, which no number of photons is
    return np.maximum(framed[margin : margin + shape[0], margin : margin + shape[1]], 0.0)


def _bands(row: F64, edge: int, rows: int) -> tuple[I64, I64]:
    """Sort particles by the band of rows that they lie in.

    Returns their order, and where each band's start.
    """
    band = np.rint(row).astype(np.int64) // edge
    counts = np.bincount(band, minlength=-(-rows // edge))
    return np.argsort(band, kind="stable"), np.concatenate([[0], np.cumsum(counts)])


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
    edges, factors = np.zeros((2, 3, most)), np.zeros((2, most))
    for i in range(first, last):
        left = int(np.rint(pixel[i, 0])) - half[i, 0]
        top = int(np.rint(pixel[i, 1])) - half[i, 1]
        width, height = 2 * half[i, 0] + 1, 2 * half[i, 1] + 1
        fill_shares(pixel[i, 0], sigma[i, 0], left, factors[0, :width])
        fill_shares(pixel[i, 1], sigma[i, 1], top, factors[1, :height])
        factors[0, width : width + _LANES] = 0.0
        _add_product(image, top, left, photons[i], factors[1], factors[0], height, width)
        power, n = tilt[i], 1
        if abs(power) > _EXACT:
            _start_terms(pixel[i, 0], sigma[i, 0], left, width, edges[0])
            _start_terms(pixel[i, 1], sigma[i, 1], top, height, edges[1])
        while abs(power) > _EXACT * n:
            _fill_term(edges[0], width, factors[0])
            _fill_term(edges[1], height, factors[1])
            light = photons[i] * power / n
            _add_product(image, top, left, light, factors[1], factors[0], height, width)
            _next_terms(edges[0], width, n)
            _next_terms(edges[1], height, n)
            power, n = power * tilt[i], n + 1


@numba.njit(cache=True, fastmath=_ANY_ORDER)
def _add_product(
    image: Any, top: int, left: int, light: float, down: Any, across: Any, height: int, width: int
) -> None:
    """Add light times an outer product.

    Columns are zero up to a whole number of lanes.
    """
    start = np.uintp(left)
    for j in range(height):
        row, share = np.uintp(top + j), light * down[j]
        for block in range((width + _LANES - 1) // _LANES):
            for lane in range(_LANES):
                k = np.uintp(block * _LANES + lane)
                image[row, start + k] += share * across[k]


# The n-th term is r^n / n times the difference of h between both edges of a column, times that of a
# row: h is the normal density times Hermite's polynomial of order n - 1, over the root of (n - 1)!.


@numba.njit(cache=True)
def _start_terms(center: float, sigma: float, first: int, size: int, edges: Any) -> None:
    """Fill in edges (standard deviations), h, and h of the order before."""
    for i in range(size + 1):
        z = (first + i - 0.5 - center) / sigma
        edges[0, i], edges[1, i] = z, math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        edges[2, i] = 0.0


@numba.njit(cache=True)
def _fill_term(edges: Any, size: int, factors: Any) -> None:
    for i in range(size):
        factors[i] = edges[1, i] - edges[1, i + 1]


@numba.njit(cache=True)
def _next_terms(edges: Any, size: int, n: int) -> None:
    """Raise the order of h from n - 1 to n."""
    before, over = math.sqrt(n - 1.0), 1.0 / math.sqrt(float(n))
    for i in range(size + 1):
        higher = (edges[0, i] * edges[1, i] - before * edges[2, i]) * over
        edges[2, i], edges[1, i] = edges[1, i], higher
