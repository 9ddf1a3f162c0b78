"""Analytic renderer: Gaussian particle images, integrated over each pixel."""

from __future__ import annotations

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
_BAND = 64  # rows that one thread fills at a time, so that none writes where another does


def render(camera: Camera, images: ParticleImages) -> F64:
    """Render photons (rows, columns) of one exposure.

    Light outside a particle's window of `_REACH` standard deviations is left out. Particles whose
    centre lies outside the sensor still illuminate the pixels that their window reaches.
    """
    image = np.zeros((camera.rows, camera.columns))
    bright = images.photons > 0.0
    half = np.ceil(_REACH * images.sigma_px[bright] + 0.5).astype(np.int64)
    sigma = np.maximum(images.sigma_px[bright], _SHARPEST)
    _add_windows(image, images.pixel[bright], images.photons[bright], sigma, half)
    return image


@numba.njit(cache=True, parallel=True)
def _add_windows(image: Any, pixel: Any, photons: Any, sigma: Any, half: Any) -> None:
    """Add the windows of 2 half + 1 pixels around all particles to an image."""
    rows, columns = image.shape
    for band in numba.prange((rows + _BAND - 1) // _BAND):
        first, last = band * _BAND, min(band * _BAND + _BAND, rows) - 1
        for i in range(len(photons)):
            row, column = int(np.rint(pixel[i, 1])), int(np.rint(pixel[i, 0]))
            top, bottom = max(row - half[i], first), min(row + half[i], last)
            left, right = max(column - half[i], 0), min(column + half[i], columns - 1)
            if top > bottom or left > right:
                continue
            across = _shares(pixel[i, 0], sigma[i], left, right)
            down = _shares(pixel[i, 1], sigma[i], top, bottom)
            for j in range(len(down)):
                light = photons[i] * down[j]
                for k in range(len(across)):
                    image[top + j, left + k] += light * across[k]


@numba.njit(cache=True)
def _shares(center: float, sigma: float, first: int, last: int) -> Any:
    """Compute shares of a Gaussian's integral in the pixels first to last."""
    shares = np.empty(last - first + 1)
    fill_shares(center, sigma, first, shares)
    return shares
