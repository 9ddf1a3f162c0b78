"""Image statistics of a frame, to derive other programs' settings."""

from dataclasses import dataclass

import numpy as np

from sabench.api import Observation
from sabench.images.peaks import find_peaks
from sabench.images.widths import image_widths
from sabench.utils.arrays import F32, FROM_MAD

# smallest peak, relative to a bright particle's and to the background's standard deviation: the
# larger of both holds
_FLOOR, _NOISE = 0.05, 5.0


@dataclass(frozen=True)
class FrameStatistics:
    """Statistics of one frame's particle images.

    Attributes
    ----------
    floor : smallest peak of a particle image, relative to a bright particle's.
    particles : number of particle images, median over the cameras.
    sigma_px : width of an isolated particle's image, median over the cameras.
    mm_per_px : at the centre of the volume, median over the cameras.
    spacing_mm : edge of a cube that contains one particle on average.
    """

    floor: float
    particles: int
    sigma_px: float
    mm_per_px: float
    spacing_mm: float


def measure_frame(frame: Observation) -> FrameStatistics:
    """Measure a frame's particle images."""
    images = frame.normalised_images()
    floor = max(_FLOOR, *(_NOISE * background_noise(image) for image in images))
    peaks = [find_peaks(image, floor).pixels for image in images]
    count = int(np.median([len(pixels) for pixels in peaks]))
    grid = frame.grid
    voxel, middle = np.asarray(grid.voxel_mm), np.mean(grid.centers_mm(), axis=0)
    step = np.array([voxel[0], 0.0, 0.0])
    shift = [
        np.linalg.norm(np.diff(camera.project(np.stack([middle - step, middle + step]))[0], axis=0))
        for camera in frame.cameras
    ]
    spacing = float(np.cbrt(np.prod(voxel * grid.shape[::-1]) / max(count, 1)))
    return FrameStatistics(
        floor,
        count,
        float(np.median(image_widths(images, peaks))),
        float(2.0 * voxel[0] / np.median(shift)),
        spacing,
    )


def background_noise(image: F32) -> float:
    """Estimate the standard deviation of an image's dark part.

    It follows from the median distance of the dark pixels to the image's median.
    """
    middle = np.median(image)
    dark = image[image <= 2.0 * middle] if middle > 0.0 else image
    return float(FROM_MAD * np.median(np.abs(dark - middle)))
