"""Statistics of a camera's images: light, noise, and particle images.

They need no calibration, and are computed alike from images of data sets and of laboratories. Grey
values are scaled so that a saturated pixel has 255.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sabench.images.particle_fits import fit_particle_images
from sabench.images.repair import above_background
from sabench.utils.arrays import F32, F64, U16

WHITE = 255.0  # grey value to which a saturated pixel is scaled
LEAST_FRAMES = 3  # for the noise of a stack
_DIM = 50.0  # percentile of the pixels' medians below which they are dim
_MIDDLE = 1.2  # variance of the mean of the middle half of n normal numbers, times n
_FAR, _ROUNDS = 4.0, 3  # standard deviations at which values are clipped, and how often
_FROM_MAD = 1.4826  # standard deviation of normal numbers, over their median absolute deviation


@dataclass(frozen=True)
class CameraStatistics:
    """Statistics of a camera's images.

    Grey values are of 255. NaN where images do not tell.

    Attributes
    ----------
    saturated : share of the pixels.
    background_p5, background_p50, background_p95 : percentiles of the local background, the least
        value within 9 x 9 pixels of the image that a median over 3 x 3 pixels has smoothed.
    fixed : standard deviation of dim pixels' typical values, without what temporal noise adds. The
        typical value is the mean of the middle half of the frames' values; dim pixels are the half
        of all pixels with the lowest medians of 5 x 5 typical values around them.
    fixed_near : the same of each pixel less that median, without values more than four of it away,
        as hot pixels have: what differs from pixel to pixel.
    temporal : standard deviation of dim pixels from frame to frame, without particles that pass.
    width_p10, width_p50, width_p90 : percentiles of `ParticleImages.width_px`.
    ln_flux : standard deviation of ln flux of particle images.
    per_pixel : peaks per pixel.
    contrast : of a median peak: (its brightest pixel - background) / (their sum).
    """

    saturated: float
    background_p5: float
    background_p50: float
    background_p95: float
    fixed: float
    fixed_near: float
    temporal: float
    width_p10: float
    width_p50: float
    width_p90: float
    ln_flux: float
    per_pixel: float
    contrast: float


def measure_camera(frames: Sequence[U16], white_dn: float) -> CameraStatistics:
    """Measure the images (row, column) that one camera took one after the other.

    Parameters
    ----------
    white_dn : grey value of a saturated pixel.
    """
    stack = np.stack(frames)
    scale = WHITE / white_dn
    low = np.stack([local_background(frame) for frame in frames])
    fixed, near, temporal = measure_noise(stack) if len(stack) >= LEAST_FRAMES else [np.nan] * 3
    fits = [fit_particle_images(frame, white_dn) for frame in frames]
    width, flux, height = (
        np.concatenate([getattr(one, name) for one in fits])
        for name in ("width_px", "flux", "height")
    )
    background = (scale * np.percentile(low, [5.0, 50.0, 95.0])).tolist()
    median = scale * float(np.median(height)) if len(height) else np.nan
    widths = np.percentile(width, [10.0, 50.0, 90.0]).tolist() if len(width) else [np.nan] * 3
    return CameraStatistics(
        saturated=float((stack >= white_dn).mean()),
        **{f"background_p{p}": one for p, one in zip((5, 50, 95), background, strict=True)},
        fixed=scale * fixed,
        fixed_near=scale * near,
        temporal=scale * temporal,
        **{f"width_p{p}": one for p, one in zip((10, 50, 90), widths, strict=True)},
        ln_flux=float(np.std(np.log(flux))) if len(flux) > 1 else np.nan,
        per_pixel=sum(one.found for one in fits) / stack.size,
        contrast=median / (median + 2.0 * background[1]),
    )


def local_background(grey: U16) -> U16:
    """Compute the darkest part around every pixel (row, column).

    Single dead pixels do not count.
    """
    return np.asarray(grey.astype(np.float32) - above_background(grey)[0]).astype(np.uint16)


def measure_noise(stack: U16) -> tuple[float, float, float]:
    """Measure the noise of dim pixels of images (frame, row, column).

    Returns `fixed`, `fixed_near` and `temporal` of `CameraStatistics`, in grey values.
    """
    import cv2

    quarter = len(stack) // 4
    middle = np.sort(stack, axis=0)[quarter : len(stack) - quarter].mean(axis=0, dtype=np.float32)
    around = cv2.medianBlur(middle, 5)  # selects without a view to a pixel's own flaws
    dim = around <= np.percentile(around, _DIM)
    temporal = _clipped_deviation(np.diff(stack.astype(np.float32), axis=0)[:, dim]) / np.sqrt(2.0)
    rest = _MIDDLE / len(stack) * temporal**2
    deviations = (
        float(middle[dim].std(dtype=np.float64)),
        _clipped_deviation((middle - around)[dim]),
    )
    fixed, fixed_near = (float(np.sqrt(max(one**2 - rest, 0.0))) for one in deviations)
    return fixed, fixed_near, temporal


def _clipped_deviation(values: F32) -> float:
    """Compute the standard deviation of values without the few outliers.

    Those are far from the median. Unlike quantiles, it also tells noise of less than a grey value.
    """
    away = np.abs(values - np.median(values))
    limit = max(float(np.percentile(away, 68.0)), 1.0)
    for _ in range(_ROUNDS):
        deviation = float(values[away <= _FAR * limit].std(dtype=np.float64))
        limit = max(deviation, 1.0 / _FAR)
    return deviation


class RatioSpread(NamedTuple):
    """Spread of the logarithm of the ratio of a particle's flux in two cameras.

    Attributes
    ----------
    plain : standard deviation.
    robust : that of normal numbers with the same median absolute deviation.
    pairs : number of ratios.
    """

    plain: float
    robust: float
    pairs: int


def flux_ratio_spread(flux: F64) -> RatioSpread:
    """Measure how a particle's flux (camera, particle) differs between cameras.

    NaN where a camera does not show one. Each pair of cameras has its own median ratio, which does
    not count: cameras differ in gain and in angle.
    """
    logs, ratios = np.log(flux), []
    for one in range(len(flux)):
        for other in range(one):
            ratio = logs[one] - logs[other]
            ratio = ratio[np.isfinite(ratio)]
            if len(ratio) > 1:
                ratios.append(ratio - np.median(ratio))
    if not ratios:
        return RatioSpread(np.nan, np.nan, 0)
    every = np.concatenate(ratios)
    return RatioSpread(
        float(np.std(every)), _FROM_MAD * float(np.median(np.abs(every))), len(every)
    )
