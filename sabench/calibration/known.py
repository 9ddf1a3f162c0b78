"""A target's places taken as known: what classical calibrations fit each camera to."""

from __future__ import annotations

import numpy as np

from sabench.api import CalibrationCase
from sabench.arrays import F64


def known_points(case: CalibrationCase, camera: int) -> tuple[F64, F64]:
    """Places (n, 3) and pixels (n, 2) of everything that a camera found."""
    points, pixels = known_frames(case, camera)
    return np.vstack(points), np.vstack(pixels)


def known_frames(case: CalibrationCase, camera: int) -> tuple[list[F64], list[F64]]:
    """The same frame by frame, frames of which the camera found nothing left out."""
    points, pixels = [], []
    for rough, found in zip(case.rough_mm, case.pixels[camera], strict=True):
        there = np.isfinite(rough).all(axis=1) & np.isfinite(found).all(axis=1)
        if there.any():
            points.append(rough[there])
            pixels.append(found[there])
    return points, pixels
