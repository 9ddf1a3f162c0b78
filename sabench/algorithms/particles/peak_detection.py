"""Peaks of particle images in all cameras of a frame."""

from __future__ import annotations

from sabench.api import Observation
from sabench.images.brightness import bright_dn
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.peak_detection import detect_peaks
from sabench.images.peaks import Peaks


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
