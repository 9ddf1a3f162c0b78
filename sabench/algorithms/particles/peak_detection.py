"""Peaks of particle images in all cameras of a frame."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from sabench.api import Observation, Parameters
from sabench.images.brightness import bright_dn
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.peak_detection import detect_peaks
from sabench.images.peaks import Peaks
from sabench.utils.arrays import F32, F64, I64


class PeakParameters(Parameters):
    """Thresholds of particle images."""

    floor: float = Field(
        0.05,
        gt=0.0,
        lt=1.0,
        description="smallest peak of a particle image, over that of a bright particle",
    )
    false_alarms: float = Field(
        FALSE_ALARMS,
        gt=0.0,
        lt=0.5,
        description="probability that noise makes a particle image of a pixel; the larger of both "
        "thresholds holds",
    )


def detect_in_cameras(
    case: Observation, floor: float, false_alarms: float = FALSE_ALARMS
) -> tuple[Peaks, ...]:
    """Detect peaks of particle images in each camera's image.

    Parameters
    ----------
    floor : smallest peak, over that of a bright particle.
    false_alarms : probability that noise makes a peak of a pixel.
    """
    good, black = case.repaired, case.black_dn
    return tuple(
        detect_peaks(
            grey,
            unknown,
            least_dn=black + floor * bright_dn(grey, black, unknown),
            false_alarms=false_alarms,
        )
        for grey, unknown in zip(good.images, good.flaws.unknown, strict=True)
    )


def heights(peaks: Peaks, image: F32) -> F32:
    """Return the image (n,) at the pixels of peaks."""
    column, row = np.rint(peaks.pixels).astype(np.int64).T
    return np.asarray(image[row, column])


def heights_of(hit: I64, peaks: tuple[Peaks, ...], images: F32) -> F64:
    """Return the brightest pixels (n, camera) of candidates' particle images.

    0 where a camera shows none.

    Parameters
    ----------
    hit : (n, camera) numbers of the peaks; -1 where a camera shows none.
    """
    out = np.zeros(hit.shape)
    for camera, (one, image) in enumerate(zip(peaks, images, strict=True)):
        there = hit[:, camera] >= 0
        out[there, camera] = heights(one, image)[hit[there, camera]]
    return out
