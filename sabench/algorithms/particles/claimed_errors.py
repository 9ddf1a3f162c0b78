"""Errors of positions that a search claims: bounds with the noise of residuals."""

from typing import Any

import numpy as np

from sabench.algorithms.particles.all_particles import leverage
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import (
    MOST_FLAT,
    ImageModel,
    ModelParticles,
    shape_at,
    without_margins,
)
from sabench.geometry.volume_polynomials import project_with_slopes
from sabench.images.position_bounds import ParticleSpots, position_bounds
from sabench.utils.arrays import F64
from sabench.utils.compiled import numba
from sabench.utils.threads import for_each

_LEAST_ERROR_PX = 0.002  # of positions, added to those from the images
_NARROWEST_PX = 0.1  # axis of an image
_LEAST = 1e-100  # variance of images without noise
_STEPS, _LEAST_FREE = 4, 0.2  # of fits of the variance, and least share of a pixel that is free


def claimed_covariances(
    model: ImageModel, sigma: F64, particles: ModelParticles, noise: F64
) -> F64:
    """Estimate the covariances (n, 3, 3) of the positions' errors, mm2.

    They are the Cramer-Rao bounds with neighbours fitted, too, and the noise of what is left
    around particles, at most those of a position anywhere in the box. Dark pixels have the noise
    (camera,).
    """
    maps, taken = model.maps, leverage(model, sigma, particles)
    images, left, weight, taken = (
        without_margins(padded) for padded in (model.images, model.left, model.weight, taken)
    )

    def spots_in(camera: int) -> ParticleSpots:
        variance = np.zeros(images[camera].shape)
        each = images[camera], left[camera], weight[camera], taken[camera]
        fill_noise(*each, float(noise[camera]), variance)
        return _spots(model, particles, camera, variance)

    spots = for_each(spots_in, len(noise))
    bounds = position_bounds(spots, np.arange(len(particles.position)))
    anywhere = np.diag(maps.half_mm**2 / 3.0)
    lost = ~np.isfinite(bounds).all(axis=(1, 2)) | (np.trace(bounds, 0, 1, 2) > anywhere.sum())
    bounds[lost] = anywhere
    least = (_LEAST_ERROR_PX * pixel_mm(maps)) ** 2
    return np.asarray(bounds + least * np.eye(3))


def _spots(
    model: ImageModel, particles: ModelParticles, camera: int, variance: F64
) -> ParticleSpots:
    """Make round images of equal area, which fix particles as well as the true ones."""
    pixel, slope = project_with_slopes(model.maps, camera, particles.position)
    shapes = model.shapes[camera]
    across, down, tilt, flatness = (shape_at(shape, particles.position.T) for shape in shapes)
    spread = np.array([[across**2, tilt], [tilt, down**2]]).transpose(2, 0, 1)
    squares, axes = np.linalg.eigh(spread)
    squares = np.maximum(squares, _NARROWEST_PX**2)
    width = squares.prod(axis=1) ** 0.25
    flatness = np.clip(flatness, 0.0, MOST_FLAT)
    # integral of the squared slopes of a flat image over that of a Gaussian, by their spectra
    steep = 1.0 - 12.0 * flatness + 120.0 * flatness**2
    scaled = axes * (width * np.sqrt(steep) / np.sqrt(squares).T).T[:, None]
    slope = scaled @ axes.transpose(0, 2, 1) @ slope
    light = particles.light[:, camera]
    return ParticleSpots(pixel, slope / model.maps.half_mm, light, width, variance)


@numba.njit(cache=True)
def fit_line(total: float, x: float, y: float, xx: float, xy: float) -> tuple[float, float]:
    """Fit a line to sums of weights, x, y, x^2, x y; returns value at 0 and slope."""
    if not total > 0.0:
        return 0.0, 0.0
    bend = xx - x * x / total
    slope = (xy - x * y / total) / bend if bend > 1e-12 * xx else 0.0
    return (y - slope * x) / total, slope


@numba.njit(cache=True, nogil=True)
def fill_noise(
    shown: Any, left: Any, weight: Any, leverage: Any, noise: float, variance: Any
) -> None:
    """Fill in the variance (row, column) of a camera's pixels around particles.

    It is a line over the light, fitted to the squares that are left, over what the fits have not
    taken from them (leverage). Unknown and saturated pixels have an infinite variance.
    """
    rows, columns = shown.shape
    even, slope = noise * noise, 0.0
    for _ in range(_STEPS):
        total = x = y = xx = xy = 0.0
        for i in range(rows):
            for j in range(columns):
                light = shown[i, j] - left[i, j]
                if weight[i, j] > 0.0 and light > noise:
                    square = left[i, j] ** 2 / max(1.0 - leverage[i, j], _LEAST_FREE)
                    each = 1.0 / max(even + slope * light, _LEAST) ** 2
                    total, x, y = total + each, x + each * light, y + each * square
                    xx, xy = xx + each * light * light, xy + each * light * square
        even, slope = fit_line(total, x, y, xx, xy)
        even, slope = max(even, noise * noise), max(slope, 0.0)
    for i in range(rows):
        for j in range(columns):
            light = max(shown[i, j] - left[i, j], 0.0)
            variance[i, j] = even + slope * light if weight[i, j] > 0.0 else np.inf
