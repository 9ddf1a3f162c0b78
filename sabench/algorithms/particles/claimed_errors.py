"""Errors of positions that a search claims: bounds with the noise of residuals."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.all_particles import leverage
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import (
    MOST_FLAT,
    ImageModel,
    Particles,
    without_margins,
)
from sabench.algorithms.particles.pixel_variance import fill_noise
from sabench.geometry.volume_polynomials import project_with_slopes
from sabench.images.particle_spots import ParticleSpots
from sabench.images.position_bounds import position_bounds
from sabench.utils.arrays import F64
from sabench.utils.threads import for_each

_LEAST_ERROR_PX = 0.002  # of positions, beside what the images tell
_NARROWEST_PX = 0.1  # axis of an image


def claimed_covariances(model: ImageModel, sigma: F64, particles: Particles, noise: F64) -> F64:
    """Estimate the covariances (n, 3, 3) of the positions' errors, mm2.

    They are the Cramer-Rao bounds with neighbours that are fitted, too, where the noise of pixels
    is as strong as what is left around particles. The largest is that of a position anywhere in the
    box. Dark pixels have the noise (camera,).
    """
    maps, taken = model.maps, leverage(model, sigma, particles)
    images, left, weight, taken = (
        without_margins(one) for one in (model.images, model.left, model.weight, taken)
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


def _spots(model: ImageModel, particles: Particles, camera: int, variance: F64) -> ParticleSpots:
    """Make the images of the particles in a camera, with the variance of its pixels.

    They are round ones of the same area, whose centres move so much more or less with the position
    that each particle alone is known as well as from its own image.
    """
    pixel, slope = project_with_slopes(model.maps, camera, particles.position)
    terms = np.concatenate([np.ones((len(pixel), 1)), particles.position], axis=1)
    across, down, tilt, flatness = model.shapes[camera] @ terms.T
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
