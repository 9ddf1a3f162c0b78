"""Brightness of images.

One scale for all cameras, and the noise of the background.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sabench.images.repair import above_background, peak_light
from sabench.utils.arrays import F32, U16, Bool
from sabench.utils.compiled import numba

_BRIGHT = 95.0  # percentile of the illuminated pixels that becomes 1
_ILLUMINATED = 0.1  # of the brightest pixel
_PEAKS = 4.0  # typical peaks that the brightest pixel counts at most


def normalise(images: U16, black_dn: float, unknown: Bool | None = None) -> F32:
    """Scale images to a bright particle's peak in the same camera.

    Cameras record particles at different scattering angles and so at very different brightness; a
    common scale makes them count alike (the thesis matches histograms to the same end, section
    2.3). The scale is `bright_dn`, which is the same kind of pixel in a sparse and in a dense
    image.

    Parameters
    ----------
    images : (camera, row, column) grey values.
    black_dn : grey value without light.
    unknown : (camera, row, column) pixels that do not count for the scale.

    Returns
    -------
    (camera, row, column) fractions of the bright level, black level subtracted.
    """
    scaled: F32 = np.empty(images.shape, dtype=np.float32)
    for number, (grey, image) in enumerate(zip(images, scaled, strict=True)):
        level = bright_dn(grey, black_dn, None if unknown is None else unknown[number])
        _scale(grey, float(black_dn), 1.0 / max(level, 1.0), image)
    return scaled


def bright_dn(grey: U16, black_dn: float, unknown: Bool | None = None) -> float:
    """Compute the bright level of an image: a percentile of its illuminated pixels.

    It is the 95th percentile, interpolated linearly, of grey values less black of the pixels that
    exceed a tenth of the brightest; 0 without any. Pixels brighter than four typical peaks
    (`repair.peak_light`) count as four: a few of them may be anything.

    Parameters
    ----------
    unknown : pixels (row, column) that do not count.
    """
    peak = peak_light(*above_background(grey))
    known = grey.ravel() if unknown is None else grey[~unknown]
    counts = np.bincount(known, minlength=1)
    levels = np.maximum(np.arange(len(counts)) - black_dn, 0.0)
    brightest = min(levels[-1], _PEAKS * peak) if peak else levels[-1]
    counts[levels <= _ILLUMINATED * brightest] = 0
    up_to = np.cumsum(counts)
    if up_to[-1] == 0:
        return 0.0
    rank = _BRIGHT / 100.0 * (up_to[-1] - 1)
    low, high = (
        levels[np.searchsorted(up_to, math.floor(rank) + step, side="right")]
        for step in (0, min(1, math.ceil(rank) - math.floor(rank)))
    )
    return float(low + (rank - math.floor(rank)) * (high - low))


@numba.njit(cache=True, parallel=True)
def _scale(grey: Any, black: float, factor: float, image: Any) -> None:
    """Compute image = factor max(grey - black, 0)."""
    for row in numba.prange(len(grey)):
        for i in range(grey.shape[1]):
            image[row, i] = np.float32(max(grey[row, i] - black, 0.0) * factor)


def background_noise(image: F32) -> float:
    """Estimate the standard deviation of an image's dark part.

    It follows from the median distance of the dark pixels to the image's median.
    """
    middle = np.median(image)
    dark = image[image <= 2.0 * middle] if middle > 0.0 else image
    return float(1.4826 * np.median(np.abs(dark - middle)))
