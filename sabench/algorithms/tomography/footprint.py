"""Spread of one voxel's light over the pixels around its projection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

from sabench.utils.arrays import F32, F64

_BRIGHT = 0.3  # of a bright particle's peak: dimmer local maxima are not measured


@dataclass(frozen=True)
class Footprint:
    """Weights W_ij of a voxel: bilinear in the four pixels around its projection.

    Then, along either axis, pixels give `spread` to both neighbours.

    The weights of a voxel add up to 1. Voxels should be about as large as pixels: those of a coarse
    grid would leave pixels between them dark.

    Attributes
    ----------
    spread : 0 for bilinear weights, at most 1/3.
    """

    spread: float

    @property
    def margin(self) -> int:
        """Pixels by which it reaches beyond the four."""
        return 1 if self.spread else 0

    def smooth(self, images: F32) -> F32:
        """Smooth images (camera, row, column) by giving light to neighbouring pixels.

        The operator is symmetric; images are dark beyond the borders.
        """
        if not self.spread:
            return images
        kernel = np.array([self.spread, 1.0 - 2.0 * self.spread, self.spread])
        return np.stack(
            [
                cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
                for image in images
            ]
        )


BILINEAR = Footprint(0.0)


def gaussian(sigma_px: float) -> Footprint:
    """Make the footprint of a Gaussian over pixels, 0.29 <= sigma_px <= 0.86.

    It has the same variance: sigma^2 + 1/12 = 2 spread + 1/6 on the mean.
    """
    return Footprint((sigma_px**2 - 1.0 / 12.0) / 2.0)


def image_sigma_px(images: F32) -> float | None:
    """Estimate the standard deviation of the particles' images, pixel included.

    The images (camera, row, column) are scaled by `normalise`. Returns None without any particle.

    A Gaussian through three pixels of a local maximum has sigma^2 = 1 / (2 ln m - ln l - ln r).
    Particles that overlap look larger and none looks smaller, so the lower quartile is returned.
    """
    found = np.concatenate([sigma for image in images for sigma in _peak_sigmas(image)])
    return float(np.percentile(found, 25.0)) if len(found) else None


def _peak_sigmas(image: F32) -> Iterator[F64]:
    """Yield widths of every bright local maximum along columns and along rows."""
    peak = (image == maximum_filter(image, 5)) & (image > _BRIGHT)
    peak[[0, -1]] = peak[:, [0, -1]] = False
    row, column = np.nonzero(peak)
    for down, right in ((0, 1), (1, 0)):
        light = [image[row + k * down, column + k * right].astype(np.float64) for k in (-1, 0, 1)]
        before, middle, after = np.log(np.maximum(light, 1e-6))
        curvature = 2.0 * middle - before - after
        yield 1.0 / np.sqrt(curvature[curvature > 0.0])
