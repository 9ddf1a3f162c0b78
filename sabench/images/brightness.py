"""Brightness of images: scale and background."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from sabench.api import Observation
from sabench.utils.arrays import F32, U16

_BRIGHT = 95.0  # percentile of the lit pixels that becomes 1


_LIT = 0.1  # of the image's maximum


def normalised(case: Observation) -> F32:
    """Images as fractions of a bright particle's peak in the same camera, black level subtracted: (camera, row, column).

    Cameras see particles at different scattering angles and so at very different brightness; a
    common scale makes them count alike (the thesis matches histograms to the same end, section
    2.3). The scale is the 95th percentile of the pixels that reach a tenth of the image's maximum,
    which is the same kind of pixel in a sparse and in a dense image.
    """
    images: F32 = np.empty(case.images.shape, dtype=np.float32)
    for grey, image in zip(case.images, images, strict=True):
        _scale(grey, float(case.black_dn), 1.0 / max(bright_dn(grey, case.black_dn), 1.0), image)
    return images


def bright_dn(grey: U16, black_dn: float) -> float:
    """The 95th percentile, interpolated linearly, of grey values less black of the pixels that exceed a tenth of the brightest; 0 without any."""
    counts = np.bincount(grey.ravel(), minlength=1)
    levels = np.maximum(np.arange(len(counts)) - black_dn, 0.0)
    counts[levels <= _LIT * levels[-1]] = 0
    upto = np.cumsum(counts)
    if upto[-1] == 0:
        return 0.0
    place = _BRIGHT / 100.0 * (upto[-1] - 1)
    low, high = (
        levels[np.searchsorted(upto, math.floor(place) + step, side="right")]
        for step in (0, min(1, math.ceil(place) - math.floor(place)))
    )
    return float(low + (place - math.floor(place)) * (high - low))


@numba.njit(cache=True, parallel=True)
def _scale(grey: Any, black: float, factor: float, image: Any) -> None:
    """image = factor max(grey - black, 0)."""
    for row in numba.prange(len(grey)):
        for i in range(grey.shape[1]):
            image[row, i] = np.float32(max(grey[row, i] - black, 0.0) * factor)


def background(image: F32) -> float:
    """Standard deviation of the dark part of an image, from the median distance to its median."""
    middle = np.median(image)
    dark = image[image <= 2.0 * middle] if middle > 0.0 else image
    return float(1.4826 * np.median(np.abs(dark - middle)))
