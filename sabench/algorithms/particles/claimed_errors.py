"""Errors of positions that a search claims: bounds with the noise of residuals."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import (
    ImageModel,
    Particles,
    Room,
    add_leverage,
    without_margins,
)
from sabench.geometry.volume_polynomials import project_with_slopes
from sabench.images.position_bounds import ParticleSpots, position_bounds
from sabench.utils.arrays import F32, F64

_LEAST_ERROR_PX = 0.002  # of positions, beside what the images tell
_STEPS, _LEAST_FREE = 4, 0.2  # of fits of the variance, and least share of a pixel that is free


def claimed_covariances(model: ImageModel, room: Room, particles: Particles, noise: F64) -> F64:
    """Estimate the covariances (n, 3, 3) of the positions' errors, mm2.

    They are the Cramer-Rao bounds with neighbours that are fitted, too, where the noise of pixels
    is as strong as what is left around particles. The largest is that of a position anywhere in the
    box. Dark pixels have the noise (camera,).
    """
    leverage, maps = np.zeros(model.images.shape), model.maps
    add_leverage(model, room, particles, leverage)
    images, left, weight, taken = (
        without_margins(one) for one in (model.images, model.left, model.weight, leverage)
    )
    spots = []
    for c, dark in enumerate(noise):
        variance = _variance(images[c], left[c], weight[c], taken[c], float(dark))
        spots.append(_spots(model, particles, c, variance))
    bounds = position_bounds(spots, np.arange(len(particles.position)))
    anywhere = np.diag(maps.half_mm**2 / 3.0)
    lost = ~np.isfinite(bounds).all(axis=(1, 2)) | (np.trace(bounds, 0, 1, 2) > anywhere.sum())
    bounds[lost] = anywhere
    least = (_LEAST_ERROR_PX * pixel_mm(maps)) ** 2
    return np.asarray(bounds + least * np.eye(3))


def _spots(model: ImageModel, particles: Particles, camera: int, variance: F64) -> ParticleSpots:
    """Make the images of the particles in a camera, with the variance of its pixels."""
    pixel, slope = project_with_slopes(model.maps, camera, particles.position)
    terms = np.concatenate([np.ones((len(pixel), 1)), particles.position], axis=1)
    return ParticleSpots(
        pixel,
        slope / model.maps.half_mm,
        particles.light[:, camera],
        (terms @ model.widths[camera].T).mean(axis=1),
        variance,
    )


def _variance(shown: F32, left: F32, weight: F32, leverage: F64, noise: float) -> F64:
    """Estimate the variance of every pixel around particles from what is left there.

    It grows with the light. What fits have taken from it, the leverage, is given back. Unknown and
    saturated pixels tell nothing.
    """
    dark, image = noise**2, np.clip(shown - left, 0.0, None).astype(np.float64)
    lit = (weight > 0.0) & (image > noise)
    light, squares = image[lit], np.square(left[lit], dtype=np.float64)
    squares /= np.maximum(1.0 - leverage[lit], _LEAST_FREE)
    even, slope = dark, 0.0
    for _ in range(_STEPS):
        expected = even + slope * light
        terms = np.stack([np.ones_like(light), light], axis=1) / expected[:, None]
        even, slope = np.linalg.lstsq(terms, squares / expected, rcond=None)[0]
        even, slope = max(even, dark), max(slope, 0.0)
    return np.where(weight > 0.0, even + slope * image, np.inf)
