"""Widths and peaks of particle images.

A particle's image is a Gaussian that pixels average.
"""

from __future__ import annotations

import math

import numpy as np

from sabench.utils.arrays import F32, F64


def image_widths(images: F32, pixels: list[F64]) -> F64:
    """Estimate standard deviations (camera,) of lone particles' images, px.

    Each estimate uses three values along either axis, about pixels that are not on the border; a
    peak half a pixel from one is rounded away from it. The lower quartile is returned, since
    overlaps widen images.
    """
    out = []
    for image, positions in zip(images, pixels, strict=True):
        inner = np.array(image.shape[::-1]) - 2
        column, row = np.clip(np.rint(positions), 1, inner).astype(np.int64).T
        high = np.log(np.maximum(image, 1e-6))
        bends = np.concatenate(
            [
                2.0 * high[row, column] - high[row, column - 1] - high[row, column + 1],
                2.0 * high[row, column] - high[row - 1, column] - high[row + 1, column],
            ]
        )
        bends = bends[(bends > 0.05) & (bends < 20.0)]
        square = float(np.quantile(1.0 / bends, 0.25)) - 1.0 / 12.0 if len(bends) else 0.0
        out.append(math.sqrt(max(square, 0.09)))
    return np.array(out)


def peak_brightness(light: F64, sigma: F64) -> F64:
    """Compute the brightest pixel (n, camera) of particles centred on a pixel."""
    share = np.array([math.erf(0.5 / (math.sqrt(2.0) * one)) ** 2 for one in sigma])
    return np.asarray(light * share)
