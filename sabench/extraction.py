"""Before and after refocusing: images on one scale, and particles out of refocused planes."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numba
import numpy as np
from pydantic import BeforeValidator, Field

from sabench.api import Observation, Parameters
from sabench.arrays import F32, F64
from sabench.volume import Grid

_BRIGHT = 95.0  # percentile of the lit pixels that becomes 1
_LIT = 0.1  # of the image's maximum
_SHARE = {"reduced": 0.85, "whole": 0.65}  # of the particles' occupancy that a field should have: best for Q, see docs/scores.md
_STEPS = 12  # bisections of k

Keep = Literal["reduced", "whole"]


def _level(value: object) -> object:
    if value == "auto" or (isinstance(value, float | int) and value >= 0):
        return value
    raise ValueError(f"expected auto or a number of at least 0, got {value!r}")


class ExtractionParameters(Parameters):
    """How particles are taken out of a refocused plane."""

    k: Annotated[float | Literal["auto"], BeforeValidator(_level)] = Field(
        "auto", description="threshold = mean + k standard deviations of the plane; auto: by the share of the volume that particles fill"
    )
    keep: Keep = Field("reduced", description="what stays of a value above the threshold: its excess, or all of it")


def normalised(case: Observation) -> F32:
    """Images as fractions of a bright particle's peak in the same camera, black level subtracted: (camera, row, column).

    Cameras see particles at different scattering angles and so at very different brightness; a common scale makes them count alike
    (the thesis matches histograms to the same end, section 2.3). The scale is the 95th percentile of the pixels that reach a tenth
    of the image's maximum, which is the same kind of pixel in a sparse and in a dense image.
    """
    images: F32 = np.maximum(case.images.astype(np.float32) - np.float32(case.black_dn), np.float32(0.0))
    for image in images:
        lit = image[image > _LIT * image.max()]
        image /= max(float(np.percentile(lit, _BRIGHT)) if len(lit) else 0.0, 1.0)
    return images


def extracted(volume: F32, case: Observation, parameters: ExtractionParameters) -> F32:
    """`extract` as the parameters say, with `auto_k` where they leave k to the images; works in place on (z, y, x) and returns it."""
    k = auto_k(volume, occupancy(case), parameters.keep) if parameters.k == "auto" else parameters.k
    return extract(volume, k, parameters.keep)


def extract(volume: F32, k: float, keep: Keep) -> F32:
    """Zero all that is below mean + k std of its plane; works in place on (z, y, x) and returns it.

    Source: thesis section 2.2.3; whether the threshold is subtracted is not stated there, so both are offered.
    """
    for plane in volume:
        threshold = np.float32(plane.mean(dtype=np.float64) + k * plane.std(dtype=np.float64))
        if keep == "reduced":
            np.maximum(plane - threshold, 0.0, out=plane)
        else:
            plane[plane <= threshold] = 0.0
    return volume


def occupancy(case: Observation) -> float:
    """The share of the grid's voxels that particles should fill, from the images alone: (sum E)^2 / (n sum E^2) of a perfect reconstruction E.

    n particles of relative brightness b, alike but for it, give images of (mean)^2 / variance = n A <b>^2 / (<b^2> pixels), however they overlap
    (Campbell's theorem), with A the effective area of a particle's image; the volume's share follows with an effective volume A w in place
    of A, w being a particle's effective depth in voxels. Assumed are a dark background, light from the grid's particles only, and voxels whose x
    edge is a pixel's size or, if it is not, particles as wide in voxels as in pixels, as E_s has them. The median camera counts.
    """
    return float(np.median([_filled(image.astype(np.float64) - case.black_dn, case.grid) for image in case.images]))


def _filled(image: F64, grid: Grid) -> float:
    light = image.mean()
    image = image - light
    variance = float(np.mean(image**2))
    if not variance > 0.0:
        return 0.0
    beside = (float(np.mean(image[:, 1:] * image[:, :-1])) + float(np.mean(image[1:] * image[:-1]))) / (2.0 * variance)
    sigma_px = math.sqrt(max(-0.25 / math.log(min(max(beside, 1e-3), 0.999)) - 1.0 / 12.0, 0.01))  # of a Gaussian averaged over pixels
    depth = effective_width(sigma_px * grid.voxel_mm[0] / grid.voxel_mm[2])
    return float(light**2 / variance * image.size * depth / math.prod(grid.shape))


def effective_width(sigma: float) -> float:
    """(integral)^2 / (sum of squares) of a Gaussian averaged over voxels, mean over its positions; sigma and width in voxels.

    2 sqrt(pi) sigma for a wide one, 1 for a narrow one.
    """
    edge = 1.0 / (2.0 * sigma)
    return 1.0 / (math.erf(edge) + (math.exp(-(edge**2)) - 1.0) / (edge * math.sqrt(math.pi)))


def auto_k(volume: F32, share: float, keep: Keep) -> float:
    """The k >= 0 at which what `extract` leaves fills the given share of the volume, by bisection; the volume (z, y, x) is not changed.

    Parameters
    ----------
    share : `occupancy`; the field aims at 0.85 (reduced) or 0.65 (whole) of it.
    """
    means = np.array([plane.mean(dtype=np.float64) for plane in volume])
    spreads = np.array([plane.std(dtype=np.float64) for plane in volume])
    target = _SHARE[keep] * share * volume.size

    def fills_more(k: float) -> bool:
        thresholds = means + k * spreads
        sums = np.zeros((len(volume), 2))
        _sum_above(volume, thresholds, thresholds if keep == "reduced" else np.zeros_like(thresholds), sums)
        light, square = sums.sum(axis=0)
        return bool(light**2 > target * square)

    low, high = 0.0, 1.0
    while fills_more(high):
        low, high = high, 2.0 * high
    for _ in range(_STEPS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if fills_more(middle) else (low, middle)
    return low


@numba.njit(cache=True, parallel=True)
def _sum_above(volume: Any, thresholds: Any, bases: Any, sums: Any) -> None:
    """sums[plane] = sum of E - base and of its square over the voxels above the plane's threshold."""
    for plane in numba.prange(len(volume)):
        light = square = 0.0
        for row in volume[plane]:
            for value in row:
                if value > thresholds[plane]:
                    excess = value - bases[plane]
                    light += excess
                    square += excess * excess
        sums[plane, 0], sums[plane, 1] = light, square
