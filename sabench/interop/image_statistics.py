"""What a frame shows of its particles, by which other programs' settings are chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.algorithms.particles.refinement import image_widths
from sabench.api import Observation
from sabench.images.brightness import background_noise, normalised
from sabench.images.peaks import find_peaks

_FLOOR, _NOISE = (
    0.05,
    5.0,
    # smallest peak over a bright particle's, and over the background's standard deviation: the
    # larger
    # one
)


@dataclass(frozen=True)
class Seen:
    """Figures of one frame.

    Attributes
    ----------
    floor : smallest peak of a particle image, over a bright particle's.
    particles : particle images, the median over the cameras.
    sigma_px : width of a lone particle's image, the same.
    mm_per_px : in the middle of the volume, the same.
    spacing_mm : edge of the cube that one of these particles has for itself.
    """

    floor: float
    particles: int
    sigma_px: float
    mm_per_px: float
    spacing_mm: float


def seen_in(frame: Observation) -> Seen:
    """What a frame shows."""
    images = normalised(frame.images, frame.black_dn)
    floor = max(_FLOOR, *(_NOISE * background_noise(image) for image in images))
    peaks = [find_peaks(image, floor).pixels for image in images]
    count = int(np.median([len(one) for one in peaks]))
    low, voxel, shape = (
        np.asarray(frame.grid.low_mm),
        np.asarray(frame.grid.voxel_mm),
        np.asarray(frame.grid.shape[::-1]),
    )
    middle = low + voxel * (shape - 1) / 2.0
    step = np.array([voxel[0], 0.0, 0.0])
    shift = [
        np.linalg.norm(np.diff(camera.project(np.stack([middle - step, middle + step]))[0], axis=0))
        for camera in frame.cameras
    ]
    spacing = float(np.cbrt(np.prod(voxel * shape) / max(count, 1)))
    return Seen(
        floor,
        count,
        float(np.median(image_widths(images, peaks))),
        float(2.0 * voxel[0] / np.median(shift)),
        spacing,
    )
