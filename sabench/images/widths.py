"""Widths and light of particle images, without a fit of each of them.

`measure_images` takes statistics of all pixels. No particle has to be found first, and overlaps do
no harm: for particles at random, products of pixels some distance apart follow from one particle's
image (Campbell's theorem: N. R. Campbell, The study of discontinuous phenomena, Proc. Camb. Phil.
Soc. 15, 117-136, 1909). Glints that outshine all are left out. Where few particles make an image
hardly brighter than its background, peaks are used.

`image_widths` is faster and coarser: three pixels across each peak. `images.statistics` fits a
Gaussian to each peak, and `particles.learned_model` all cameras' images of the particles found.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sabench.images.dark_noise import FEWEST
from sabench.images.peaks import CLEAR
from sabench.utils.arrays import F32, F64, Bool

# Statistics of all pixels:
_LEAST_SIGMA, MOST_SIGMA = 0.3, 2.5  # px
# less is chance; px: least width of images for a tilt, worth .003 and 7 % of RMS of narrow images
_LEAST_TILT, _LEAST_TILTED = 0.1, 0.45
LOCAL_PX = 61  # edge of a square with many particles' images
LEAST_NOISE = 0.5  # grey values: of rounding
SPOT_PX = 7  # edge of a square around a particle's image; that around a glint is twice as wide
_OUTSHINES = 0.1  # share of an image's squared light
PIXEL = 1.0 / 12.0  # variance of a pixel's extent, px2


def image_widths(images: F32, pixels: list[F64]) -> F64:
    """Estimate standard deviations (camera,) of isolated particles' images, px.

    Three values along either axis, about pixels not on the border, give each estimate; a peak half
    a pixel from one is rounded away from it. The lower quartile counts: overlaps widen images.
    """
    out = []
    for image, positions in zip(images, pixels, strict=True):
        inner = np.array(image.shape[::-1]) - 2
        column, row = np.clip(np.rint(positions), 1, inner).astype(np.int64).T
        high = np.log(np.maximum(image, 1e-6))
        across = 2.0 * high[row, column] - high[row, column - 1] - high[row, column + 1]
        down = 2.0 * high[row, column] - high[row - 1, column] - high[row + 1, column]
        bends = np.concatenate([across, down])
        bends = bends[(bends > 0.05) & (bends < 20.0)]
        square = float(np.quantile(1.0 / bends, 0.25)) - PIXEL if len(bends) else 0.0
        out.append(math.sqrt(max(square, 0.09)))
    return np.array(out)


def peak_brightness(light: F64, sigma: F64) -> F64:
    """Compute the brightest pixel (n, camera) of particles centred on a pixel."""
    share = np.array([math.erf(0.5 / (math.sqrt(2.0) * width)) ** 2 for width in sigma])
    return np.asarray(light * share)


@dataclass(frozen=True)
class ImageStatistics:
    """Statistics of the particles in the images of all cameras.

    Attributes
    ----------
    sigma : (camera, 2) standard deviations of particle images along columns and rows, px.
    tilt : (camera,) correlation of columns and rows within particle images, between -1 and 1: that
        of an oblique ellipse.
    light : (camera,) sum of the grey values of a typical particle's image; particles of different
        light count by their light. 0 where none shows.
    noise : (camera,) standard deviation of dark pixels, grey values.
    shown : (camera,) whether an image shows particles: it is not dark, even or all noise.
    number : particles in the images; the median over the cameras that show them.
    """

    sigma: F64
    tilt: F64
    light: F64
    noise: F64
    shown: Bool
    number: float


def measure_images(images: F64, valid: Bool) -> ImageStatistics:
    """Measure images (camera, row, column) less black; valid pixels count."""
    views = list(zip(images, valid, strict=True))
    pixels = [image[used] for image, used in views]
    measured = [_measure_image(image, _without_brightest(image, used)) for image, used in views]
    sigma, tilt, light, shown = map(np.array, zip(*measured, strict=True))
    noise = np.array([noise_below_black(values) for values in pixels])
    sums = np.array([float(values.sum()) for values in pixels])
    number = np.maximum(sums[shown] / light[shown], 1.0)
    typical = float(np.median(number)) if shown.any() else 0.0
    return ImageStatistics(sigma, tilt, light, noise, shown, typical)


def noise_below_black(values: F64 | F32) -> float:
    """Estimate the standard deviation of dark pixels from the values below black."""
    below = values[values < 0.0]
    return max(float(np.sqrt(np.mean(below**2))) if len(below) > FEWEST else 0.0, LEAST_NOISE)


def _without_brightest(image: F64, valid: Bool) -> Bool:
    """Leave out squares with over a tenth of the squared light if peaks are left."""
    squares = np.where(valid, image, 0.0) ** 2
    inside = cv2.boxFilter(squares, -1, (2 * SPOT_PX + 1,) * 2, normalize=False)
    rest: Bool = valid & (inside <= _OUTSHINES * squares.sum())
    left = _peaks(np.where(rest, image, 0.0), noise_below_black(image[valid])).sum()
    return valid if left < FEWEST else rest


def _measure_image(image: F64, valid: Bool) -> tuple[tuple[float, float], float, float, bool]:
    """Measure widths (columns, rows), tilt, light, and if particles show.

    Products of pixels d apart, less the local mean, fall as exp(-d2 / (4 s2)), s2 = sigma2 + 1/12:
    of tilted images (1 - tilt2) times that. Those one and two pixels apart give s. That at distance
    0 follows without the noise of a pixel: it is the number of particles times their mean squared
    light over 4 pi s_x s_y. The mean is the number times their mean light.
    """
    light, count = np.where(valid, image, 0.0), valid.astype(np.float64)
    # less the mean of the known pixels around: where more particles are in the middle than at the
    # borders, products of pixels far apart, which leave out borders, would be larger than others
    sums, counts = (
        cv2.boxFilter(of, -1, (LOCAL_PX, LOCAL_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
        for of in (light, count)
    )
    over = np.asarray(light - count * sums / np.maximum(counts, 1.0))
    beyond = (SPOT_PX - 1, SPOT_PX)  # px: so far apart, pixels share no particle
    apart = [_product(over, count, *step) for d in beyond for step in ((0, d), (d, 0))]
    far = sum(apart) / len(apart)
    widest = MOST_SIGMA**2 + PIXEL
    steps = (0, 1), (1, 0)
    near = np.array([[_product(over, count, d * i, d * j) for d in (1, 2)] for i, j in steps]) - far
    squares: list[float] = []
    at_zero: list[float] = []
    for first, second in near.tolist():
        square = 0.75 / math.log(first / second) if first > second > 0.0 else 0.0
        square = min(max(square, _LEAST_SIGMA**2 + PIXEL), widest)
        squares.append(square)
        at_zero.append(max(first, 0.0) * math.exp(0.25 / square))
    # products along one diagonal over those along the other: they fall as exp(-d C^-1 d / 4), and
    # minus the logarithm of their ratio is the element of C^-1 outside its diagonal
    along = _product(over, count, 1, 1) - far
    against = _product(over[:, ::-1], count[:, ::-1], 1, 1) - far
    tilt = math.log(along / against) if min(along, against) > 0.0 else 0.0
    tilt *= math.sqrt(squares[0] * squares[1])
    most = math.sqrt(1.0 - (_LEAST_SIGMA**2 + PIXEL) / widest)
    tilted = abs(tilt) > _LEAST_TILT and min(squares) > _LEAST_TILTED**2 + PIXEL
    tilt = min(max(tilt, -most), most) if tilted else 0.0
    area = 4.0 * math.pi * math.sqrt(squares[0] * squares[1] / (1.0 - tilt * tilt))
    squares = [min(square / (1.0 - tilt * tilt), widest) for square in squares]
    mean = float(light.sum() / max(count.sum(), 1.0))
    flux = 0.5 * sum(at_zero) * area
    flux = flux / mean if mean > 0.0 else _light_of_peaks(light, noise_below_black(image[valid]))
    widths = math.sqrt(squares[0] - PIXEL), math.sqrt(squares[1] - PIXEL)
    values = image[valid]
    chance = float(values.var()) / math.sqrt(len(values)) if len(values) else 0.0
    clear = float(near[:, 0].mean()) > CLEAR * chance and 1e-6 < flux < math.inf
    tilt *= math.sqrt(squares[0] * squares[1]) / (widths[0] * widths[1])
    return widths, tilt, flux if clear else 0.0, clear


def _light_of_peaks(light: F64, noise: float) -> float:
    """Measure the light around the middle one of an image's peaks; infinite if few."""
    peaks = _peaks(light, noise)
    if peaks.sum() < FEWEST:
        return math.inf
    sums = cv2.boxFilter(light.astype(np.float32), -1, (SPOT_PX, SPOT_PX), normalize=False)
    return max(float(np.median(sums[peaks])), 0.0)


def _peaks(light: F64, noise: float) -> Bool:
    shown = light.astype(np.float32)
    highest = cv2.dilate(shown, np.ones((SPOT_PX, SPOT_PX), np.uint8))
    return np.asarray((shown == highest) & (shown > CLEAR * noise))


def _product(light: F64, count: F64, rows: int, columns: int) -> float:
    """Average the products of known pixels that are some rows and columns apart."""
    here = slice(0, light.shape[0] - rows), slice(0, light.shape[1] - columns)
    shifted = slice(rows, None), slice(columns, None)
    pairs = float((count[here] * count[shifted]).sum())
    return float((light[here] * light[shifted]).sum()) / max(pairs, 1.0)
