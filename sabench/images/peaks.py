"""Peaks of images to fractions of a pixel, also those above the noise alone.

Maxima of volumes are found elsewhere, since they break ties in other ways: `metrics.local_maxima`
joins plateaus, the lattice of `particles.candidate_search` keeps the first of equal points.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from sabench.images.dark_noise import FALSE_ALARMS, DarkNoise, measure_dark_noise
from sabench.utils.arrays import F32, F64, I64, U16, Bool
from sabench.utils.compiled import inner_kernel

_CELL_PX = 4.0  # edge of the square cells into which peaks are sorted
CLEAR = 8.0  # standard deviations of noise: what is brighter is no noise
# light of a pixel's eight neighbours over its own; particle images of 0.4 px have 0.6 or more
_LONE = 0.3
_SHARP = 1.0  # the same of usual peaks, where images are 0.35 px wide or less


class Peaks(NamedTuple):
    """Peaks of one image, sorted into square cells.

    Attributes
    ----------
    pixels : (n, 2) column and row.
    starts : (cells + 1,) number of each cell's first peak; cells run row by row.
    columns, rows : numbers of cells.
    """

    pixels: F64
    starts: I64
    columns: int
    rows: int


def find_peaks(image: F32, least: float | F32) -> Peaks:
    """Find the local maxima of an image (rows, columns) that are not below `least`.

    A parabola through the logarithms of three values along either axis, which is a Gaussian
    through the values, gives their positions to fractions of a pixel.

    Parameters
    ----------
    least : one value, or one for each pixel.
    """
    row, column = maxima(image, float(np.min(least)))
    high = image[row, column] >= np.broadcast_to(np.float32(least), image.shape)[row, column]
    row, column = row[high], column[high]
    height = np.log(np.maximum(image, np.float32(1e-6 + 0.01 * np.maximum(least, 0.0))))
    across = _vertex(height[row, column - 1], height[row, column], height[row, column + 1])
    along = _vertex(height[row - 1, column], height[row, column], height[row + 1, column])
    return sort_peaks(
        np.column_stack([column + across, row + along]).astype(np.float64), image.shape
    )


def keep_peaks(peaks: Peaks, numbers: I64) -> Peaks:
    """Leave out all peaks but those with these numbers, which ascend."""
    starts = np.searchsorted(numbers, peaks.starts).astype(np.int64)
    return Peaks(np.ascontiguousarray(peaks.pixels[numbers]), starts, peaks.columns, peaks.rows)


def maxima(light: F32, least: float) -> I64:
    """Find rows and columns (2, n) of inner pixels that no neighbour exceeds.

    They have `least` or more. The first of equal ones counts.
    """
    earlier = np.array([[1, 1, 1], [1, 0, 0], [0, 0, 0]], dtype=np.uint8)
    before, behind = cv2.dilate(light, earlier), cv2.dilate(light, earlier[::-1, ::-1])
    top = (light >= np.float32(least)) & (light > before) & (light >= behind)
    return np.array(np.nonzero(top[1:-1, 1:-1])) + 1


def _vertex(before: F32, here: F32, behind: F32) -> F64:
    """Compute offsets (n,), at most 0.5, of parabolas' vertices from the middle.

    The middle is that of the three values.
    """
    curvature = 2.0 * (before - 2.0 * here + behind).astype(np.float64)
    return np.clip((before - behind) / np.where(curvature < -1e-6, curvature, -np.inf), -0.5, 0.5)


def sort_peaks(pixels: F64, shape: tuple[int, ...]) -> Peaks:
    """Sort pixels (n, 2) of an image (rows, columns), all on it, into square cells."""
    rows, columns = (math.ceil(size / _CELL_PX) for size in shape)
    column, row = (pixels // _CELL_PX).astype(np.int64).T
    cell = row * columns + column
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(columns * rows + 1)).astype(np.int64)
    return Peaks(np.ascontiguousarray(pixels[order]), starts, columns, rows)


@inner_kernel()
def find_near(peaks: Any, pixel: Any, radius: float, numbers: Any) -> int:
    """Fill in numbers of peaks within a radius of a pixel; count them.

    Peaks beyond the size of the array are left out.
    """
    count = 0
    left = max(int((pixel[0] - radius) // _CELL_PX), 0)
    right = min(int((pixel[0] + radius) // _CELL_PX), peaks.columns - 1)
    top = max(int((pixel[1] - radius) // _CELL_PX), 0)
    bottom = min(int((pixel[1] + radius) // _CELL_PX), peaks.rows - 1)
    for r in range(top, bottom + 1):
        for c in range(left, right + 1):
            cell = r * peaks.columns + c
            for n in range(peaks.starts[cell], peaks.starts[cell + 1]):
                across, down = peaks.pixels[n, 0] - pixel[0], peaks.pixels[n, 1] - pixel[1]
                if math.hypot(across, down) <= radius and count < len(numbers):
                    numbers[count] = n
                    count += 1
    return count


def detect_particle_peaks(
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
    """Find peaks that reach grey values (row, column), but no single pixels."""
    light = grey - dark.level
    light[find_lone_pixels(light, dark.noise)] = 0.0
    return find_peaks(light, least_dn - dark.level)


def find_lone_pixels(light: F32, noise: F32) -> Bool:
    """Mark bright pixels without light around them, as hot pixels are.

    Light (row, column) is above the dark level. Particle images spread over several pixels; where
    most peaks show that they hardly do, those in the middle of a pixel look like hot pixels, and
    none is marked.
    """
    around = cv2.boxFilter(light, -1, (3, 3), normalize=False) - light
    lone = (light > CLEAR * noise) & (around < _LONE * light)
    row, column = maxima(np.where(light > CLEAR * noise, light, np.float32(0.0)), 0.0)
    shares = around[row, column] / light[row, column]
    others = shares[shares >= _LONE]
    if 2 * len(others) > (shares < _LONE).sum() and np.median(others) < _SHARP:
        lone[:] = False
    return np.asarray(lone)
