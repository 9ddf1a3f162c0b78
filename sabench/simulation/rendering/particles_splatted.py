"""Analytic renderer: Gaussian particle images, integrated over each pixel.

They are ellipses, whose axes may lie at any angle to the pixels.
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
_UPRIGHT = 2e-3  # correlation of columns and rows below which an ellipse is taken as upright
_NODES = np.stack(np.polynomial.legendre.leggauss(8)) / 2.0  # heights in a pixel, and weights
_BAND = 64  # rows that one thread fills at a time, so that none writes where another does


def render(camera: Camera, images: ParticleImages) -> F64:
    """Render photons (rows, columns) of one exposure.

    Light outside a particle's window of `_REACH` standard deviations is left out. Particles whose
    centre lies outside the sensor still illuminate the pixels that their window reaches.
    """
    image = np.zeros((camera.rows, camera.columns))
    bright = images.photons > 0.0
    spread = images.spread_px2[bright]
    sigma = np.sqrt(spread[:, :2])
    half = np.ceil(_REACH * sigma + 0.5).astype(np.int64)
    sigma = np.maximum(sigma, _SHARPEST)
    tilt = spread[:, 2] / (sigma[:, 0] * sigma[:, 1])
    _add_windows(image, images.pixel[bright], images.photons[bright], sigma, tilt, half, _NODES)
    return image


@numba.njit(cache=True, parallel=True)
def _add_windows(
    image: Any, pixel: Any, photons: Any, sigma: Any, tilt: Any, half: Any, nodes: Any
) -> None:
    """Add the windows of 2 half + 1 pixels around all particles to an image."""
    rows, columns = image.shape
    for band in numba.prange((rows + _BAND - 1) // _BAND):
        first, last = band * _BAND, min(band * _BAND + _BAND, rows) - 1
        for i in range(len(photons)):
            row, column = int(np.rint(pixel[i, 1])), int(np.rint(pixel[i, 0]))
            top, bottom = max(row - half[i, 1], first), min(row + half[i, 1], last)
            left, right = max(column - half[i, 0], 0), min(column + half[i, 0], columns - 1)
            if top > bottom or left > right:
                continue
            down = _shares(pixel[i, 1], sigma[i, 1], top, bottom)
            if abs(tilt[i]) < _UPRIGHT:
                across = _shares(pixel[i, 0], sigma[i, 0], left, right)
                for j in range(len(down)):
                    light = photons[i] * down[j]
                    for k in range(len(across)):
                        image[top + j, left + k] += light * across[k]
                continue
            for j in range(len(down)):
                window = image[top + j, left : right + 1]
                _add_tilted_row(
                    window, top + j, left, pixel[i], photons[i] * down[j], sigma[i], tilt[i], nodes
                )


@numba.njit(cache=True)
def _add_tilted_row(
    window: Any,
    row: int,
    left: int,
    center: Any,
    light: float,
    sigma: Any,
    tilt: float,
    nodes: Any,
) -> None:
    """Add one row of a correlated Gaussian, which has that light.

    At a given height it is a narrower Gaussian about another column; heights within the pixel are
    summed at Gauss and Legendre's points, weighted by the marginal's density.
    """
    narrow = max(sigma[0] * math.sqrt(max(1.0 - tilt * tilt, 0.0)), _SHARPEST)
    slope, weights = tilt * sigma[0] / sigma[1], np.empty(nodes.shape[1])
    for n in range(len(weights)):
        height = (row + nodes[0, n] - center[1]) / sigma[1]
        weights[n] = nodes[1, n] * math.exp(-0.5 * height * height)
    total = weights.sum()
    if total <= 0.0:
        return
    for n in range(len(weights)):
        column = center[0] + slope * (row + nodes[0, n] - center[1])
        across = _shares(column, narrow, left, left + len(window) - 1)
        for k in range(len(window)):
            window[k] += light * weights[n] / total * across[k]


@numba.njit(cache=True)
def _shares(center: float, sigma: float, first: int, last: int) -> Any:
    """Compute shares of a Gaussian's integral in the pixels first to last."""
    shares = np.empty(last - first + 1)
    fill_shares(center, sigma, first, shares)
    return shares
