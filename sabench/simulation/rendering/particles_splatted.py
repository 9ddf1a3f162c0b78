"""Analytic renderer: Gaussians integrated over each pixel, and Airy's rings.

A Gaussian has the core of Airy's pattern, but not the light far from it: 4 to 8 % of all light lies
more than five pixels away. A filter turns the Gaussian pattern of a whole image into Airy's.

Images are ellipses with axes at any angle to the pixels. By Mehler's expansion (J. reine angew.
Math. 66, 161-176, 1866) the integral of a Gaussian with the correlation r over a pixel is a series
in r whose terms are products of a column's and a row's factor, so that a window is a sum of few
outer products.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera
from sabench.images.gaussian_kernels import fill_shares
from sabench.simulation.rendering.particle_images import REACH, ParticleImages, diffraction_px
from sabench.utils.arrays import F64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores
from sabench.utils.vector_units import add_products, whole_lanes

_PARTS = 2  # of a pixel's edge
_MARGIN = 128  # parts around the image, beyond which light does not come back from the other side


def render_with_rings(camera: Camera, wavelength_nm: float, render: Callable[[Camera], F64]) -> F64:
    """Render photons (rows, columns) of Gaussian images, and give them rings.

    Pixels are rendered in four parts, since the lens resolves more than the pixels do. The image's
    spectrum is multiplied by the ratio of Airy's and the Gaussian's transfer functions: Goodman,
    Introduction to Fourier Optics (2005), eq. 6-31. Light that leaves the image is lost.

    `render` gives photons (rows, columns) in any camera.
    """
    from scipy import fft  # takes long to load

    column, row = ((place + 0.5) * _PARTS - 0.5 for place in camera.principal_point_px)
    fine = replace(
        camera,
        rows=camera.rows * _PARTS,
        columns=camera.columns * _PARTS,
        pixel_mm=camera.pixel_mm / _PARTS,
        principal_point_px=(column, row),
    )
    photons = render(fine)
    rows, columns = (fft.next_fast_len(size + _MARGIN, real=True) for size in photons.shape)
    frequency = np.hypot(fft.fftfreq(rows)[:, None], fft.rfftfreq(columns))
    gaussian = np.exp(-2.0 * (np.pi * diffraction_px(fine, wavelength_nm) * frequency) ** 2)
    number = fine.f_number * fine.principal_distance_mm / fine.focal_length_mm
    x = np.minimum((frequency / (fine.pixel_mm / (wavelength_nm * 1e-6 * number))), 1.0)
    ratio = np.asarray(2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))) / gaussian
    spectrum = fft.rfft2(photons, (rows, columns)) * ratio
    filtered = fft.irfft2(spectrum, (rows, columns))[: photons.shape[0], : photons.shape[1]]
    image = np.asarray(np.maximum(filtered, 0.0))
    shape = (camera.rows, _PARTS, camera.columns, _PARTS)
    return np.asarray(image.reshape(shape).sum(axis=(1, 3)))


# of a particle's light in any pixel: terms below are left out; and of a pixel: what is sharper
# illuminates a single one as well
_EXACT = 1e-9
_LONGEST = 0.999  # correlation beyond which an ellipse is taken for one that narrow
_ANY_ORDER = {"contract", "nsz"}


def render(camera: Camera, images: ParticleImages) -> F64:
    """Render photons (rows, columns) of one exposure.

    Light outside a particle's window of `REACH` standard deviations is left out. Particles with
    their centre outside the sensor still illuminate the pixels of their window. Pixels are exact to
    2e-8 of each particle's light, and the same for any number of threads.
    """
    image = np.zeros((camera.rows, camera.columns))
    starts, windows = _sort_windows(images.pixel, images.photons, images.spread_px2, *image.shape)
    for odd in range(2):  # even bands first, then odd
        on_cores(_add_windows, (len(starts) - odd) // 2, odd, image, starts, windows)
    on_cores(_clear, len(image), image)
    return image


@numba.njit(cache=True)
def _sort_windows(pixel: Any, photons: Any, spread: Any, rows: int, columns: int) -> Any:
    """Sort particles by the band of rows that their windows begin in.

    Those that do not illuminate the image are left out.

    Returns where each band's start, and their pixels, photons, widths, correlations, and their
    windows' first columns and rows, and widths and heights (m, 2). A window reaches from its band
    into the next one at most.
    """
    lit, corners = np.empty(len(pixel), np.int64), np.empty((len(pixel), 2), np.int64)
    sizes, count, edge, edges = np.empty_like(corners), 0, 1, (columns, rows)
    for i in range(len(pixel)):
        reached = photons[i] > 0.0
        for axis in range(2):
            reach, center = REACH * math.sqrt(spread[i, axis]), pixel[i, axis]
            reached = reached and center + reach >= -0.5 and center - reach < edges[axis] - 0.5
            if reached:
                first = math.floor(center - reach + 0.5)
                corners[count, axis] = first
                sizes[count, axis] = math.floor(center + reach + 0.5) - first + 1
        if reached:
            edge = max(edge, sizes[count, 1])
            lit[count] = i
            count += 1
    band, bands = np.empty(count, np.int64), (rows + edge - 1) // edge
    starts, place = np.zeros(bands + 1, np.int64), np.zeros(bands, np.int64)
    for n in range(count):
        band[n] = max(corners[n, 1], 0) // edge
        starts[band[n] + 1] += 1
    for b in range(bands):
        place[b] = starts[b]
        starts[b + 1] += starts[b]
    where, sigma = np.empty((count, 2)), np.empty((count, 2))
    light, tilt = np.empty(count), np.empty(count)
    corner, size = np.empty((count, 2), np.int64), np.empty((count, 2), np.int64)
    for n in range(count):
        i, to = lit[n], place[band[n]]
        place[band[n]] += 1
        for axis in range(2):
            where[to, axis] = pixel[i, axis]
            sigma[to, axis] = max(math.sqrt(spread[i, axis]), _EXACT)
            corner[to, axis] = corners[n, axis]
            size[to, axis] = sizes[n, axis]
        light[to] = photons[i]
        slant = spread[i, 2] / (sigma[to, 0] * sigma[to, 1])
        tilt[to] = min(max(slant, -_LONGEST), _LONGEST)
    return starts, (where, light, sigma, tilt, corner, size)


@numba.njit(cache=True, nogil=True)
def _clear(jobs: slice, image: Any) -> None:
    """Replace numbers below zero.

    Series and polynomials may end a little below zero, which no number of photons is.
    """
    for row in range(jobs.start, jobs.stop):
        for column in range(image.shape[1]):
            image[row, column] = max(image[row, column], 0.0)


@numba.njit(cache=True, nogil=True)
def _add_windows(jobs: slice, odd: int, image: Any, starts: Any, windows: Any) -> None:
    """Add the windows of particles in every other band."""
    for turn in range(jobs.start, jobs.stop):
        band = 2 * turn + odd
        _add_band(image, starts[band], starts[band + 1], windows)


@inner_kernel(fastmath=_ANY_ORDER)
def _add_band(image: Any, first: int, last: int, shapes: Any) -> None:
    if first == last:
        return
    pixel, photons, sigma, tilt, corner, size = shapes
    most = whole_lanes(size[first:last].max())
    all_terms = _count_terms(np.abs(tilt[first:last]).max())
    across, down = np.zeros((all_terms, most)), np.zeros((all_terms, most))
    rows, columns = image.shape
    edges = np.zeros((3, most + 1))
    part = np.zeros((min(most, rows), min(most, whole_lanes(columns))))
    for i in range(first, last):
        left, top, width, height = corner[i, 0], corner[i, 1], size[i, 0], size[i, 1]
        lanes, terms = whole_lanes(width), _count_terms(tilt[i])
        fill_shares(pixel[i, 0], sigma[i, 0], left, width, across[0])
        fill_shares(pixel[i, 1], sigma[i, 1], top, height, down[0])
        if terms > 1:
            across[1:terms, width:lanes] = 0.0
            _fill_terms(pixel[i, 0], sigma[i, 0], left, width, terms, edges, across)
            _fill_terms(pixel[i, 1], sigma[i, 1], top, height, terms, edges, down)
        light = photons[i]
        for n in range(terms):
            weight = light if n == 0 else light / n
            for j in range(height):
                down[n, j] *= weight
            light *= tilt[i]
        if left >= 0 and top >= 0 and left + lanes <= columns and top + height <= rows:
            add_products(image, top, left, down, across, terms, height, lanes)
        else:  # a window may be far larger than the sensor: only what lies on it
            above, before = max(-top, 0), max(-left, 0)
            height, width = min(height, rows - top) - above, min(width, columns - left) - before
            lanes = whole_lanes(width)
            for n in range(terms):
                for j in range(height):
                    down[n, j] = down[n, above + j]
                for k in range(lanes):
                    across[n, k] = across[n, before + k] if k < width else 0.0
            part[:height, :lanes] = 0.0
            add_products(part, 0, 0, down, across, terms, height, lanes)
            for j in range(height):
                for k in range(width):
                    image[top + above + j, left + before + k] += part[j, k]


# The n-th term is r^n / n times the difference of h between both edges of a column, times that of a
# row: h is the normal density times Hermite's polynomial of order n - 1, over the root of (n - 1)!.


@inner_kernel()
def _count_terms(tilt: float) -> int:
    """Count the terms of a series, with the one that has no correlation."""
    power, n = abs(tilt), 1
    while power > _EXACT * n:
        power, n = power * abs(tilt), n + 1
    return n


@inner_kernel(fastmath=_ANY_ORDER)
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


@inner_kernel()
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
