"""Peaks of particle images above the noise, with a known false alarm rate."""

from __future__ import annotations

import numpy as np

from sabench.images.dark_noise import FALSE_ALARMS, DarkNoise, measure_dark_noise
from sabench.images.peaks import Peaks, find_peaks, maxima
from sabench.utils.arrays import F32, U16, Bool

_CLEAR = 10.0  # standard deviations of noise above which a pixel's surroundings say what it is
# light of a pixel's eight neighbours over its own; particle images of 0.4 px have 0.6 or more
_LONE = 0.3
_BESIDE = 5.0  # standard deviations of noise: light beside a peak that noise hardly makes
_NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=np.uint8)
_SHARP = 1.0  # the same of usual peaks, where images are 0.35 px wide or less


def detect_peaks(
    grey: U16,
    unknown: Bool | None = None,
    *,
    least_dn: float = 0.0,
    false_alarms: float = FALSE_ALARMS,
) -> Peaks:
    """Detect peaks of particle images in an image (row, column).

    Parameters
    ----------
    unknown : pixels that show nothing of the particles.
    least_dn : least grey value of a peak, where the noise does not demand more.
    false_alarms : probability that noise makes a peak of a pixel.
    """
    dark = measure_dark_noise(grey[None], None if unknown is None else ~unknown)
    return find_above(grey, dark, np.maximum(dark.threshold(false_alarms), np.float32(least_dn)))


def find_above(grey: U16, dark: DarkNoise, least_dn: F32) -> Peaks:
    """Find peaks that reach grey values (row, column), but no lone pixels."""
    light = grey - dark.level
    light[find_lone_pixels(light, dark.noise)] = 0.0
    return find_peaks(light, least_dn - dark.level)


def find_lone_pixels(light: F32, noise: F32) -> Bool:
    """Mark bright pixels without light around them, as hot pixels are.

    Light (row, column) is above the dark level. Particle images spread over several pixels; where
    most peaks show that they hardly do, those in the middle of a pixel look like hot pixels, and
    none is marked.
    """
    import cv2  # takes long to load

    around = cv2.boxFilter(light, -1, (3, 3), normalize=False) - light
    lone = (light > _CLEAR * noise) & (around < _LONE * light)
    row, column = maxima(np.where(light > _CLEAR * noise, light, np.float32(0.0)), np.float32(0.0))
    shares = around[row, column] / light[row, column]
    beside = cv2.dilate(light, _NEIGHBOURS)[row, column] > _BESIDE * noise[row, column]
    others = shares[(shares >= _LONE) & beside]
    if 2 * len(others) > (shares < _LONE).sum() and np.median(others) < _SHARP:
        lone[:] = False
    return np.asarray(lone)
