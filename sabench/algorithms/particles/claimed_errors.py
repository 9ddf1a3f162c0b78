"""Errors of positions that a search claims: bounds with the noise of residuals."""

import numpy as np

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
from sabench.images.widths import PIXEL
from sabench.utils.arrays import F32, F64, Bool
from sabench.utils.threads import for_each

_LEAST_ERROR_PX = 0.002  # of positions, added to those from the images
_STEPS, _LEAST_FREE = 4, 0.2  # of fits of the variance, and least share of a pixel that is free


def claimed_covariances(model: ImageModel, particles: ModelParticles, noise: F64) -> F64:
    """Estimate the covariances (n, 3, 3) of the positions' errors, mm2.

    They are the Cramer-Rao bounds with neighbours fitted, too, and the noise of what is left
    around particles, at most those of a position anywhere in the box. Dark pixels have the noise
    (camera,).
    """
    maps, cameras = model.maps, len(noise)
    images, left, weight = map(without_margins, (model.images, model.left, model.weight))
    # of each image, its light and its part of a position
    taken = len(particles.position) * (1.0 + 3.0 / cameras)

    def spots_in(camera: int) -> ParticleSpots:
        light, counts = images[camera] - left[camera], weight[camera] > 0.0
        variance = _noise(light, left[camera], counts, float(noise[camera]), taken)
        return _spots(model, particles, camera, variance)

    spots = for_each(spots_in, cameras)
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
    squares = np.maximum(squares, PIXEL)
    width = squares.prod(axis=1) ** 0.25
    flatness = np.clip(flatness, 0.0, MOST_FLAT)
    # integral of the squared slopes of a flat image over that of a Gaussian, by their spectra
    steep = 1.0 - 12.0 * flatness + 120.0 * flatness**2
    scaled = axes * (width * np.sqrt(steep) / np.sqrt(squares).T).T[:, None]
    slope = scaled @ axes.transpose(0, 2, 1) @ slope
    light = particles.light[:, camera]
    return ParticleSpots(pixel, slope / model.maps.half_mm, light, width, variance)


def _noise(light: F32, left: F32, counts: Bool, dark: float, taken: float) -> F64:
    """Estimate the variance (row, column) of a camera's pixels.

    It is a line over the particles' light, fitted to the squares of what is left, over what the
    fits have not taken of them: so many pixels in all, spread like the root of the light, which is
    wider than images as their derivatives are. Pixels that do not count have an infinite one.
    """
    even, slope = dark**2, 0.0
    lit = counts & (light > dark)
    shown = light[lit].astype(np.float64)
    roots = np.sqrt(shown)
    free = np.maximum(1.0 - taken * roots / max(float(roots.sum()), 1.0), _LEAST_FREE)
    squares = np.square(left[lit]) / free
    for _ in range(_STEPS if len(shown) > 1 else 0):
        precision = 1.0 / (even + slope * shown)
        terms = np.stack([precision, shown * precision], axis=1)
        even, slope = np.linalg.lstsq(terms, squares * precision, rcond=None)[0]
        even, slope = max(even, dark**2), max(slope, 0.0)
    return np.where(counts, even + slope * np.maximum(light, 0.0), np.inf)
