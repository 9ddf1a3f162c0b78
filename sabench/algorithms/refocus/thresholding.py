"""Thresholding of refocused planes, and extraction of particles from them."""

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from sabench.api import Observation, Parameters
from sabench.images.gaussians import effective_width
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

# of the particles' occupancy that a field should have: tuned on seeds 101 and 102
_SHARE = {"reduced": 0.85, "whole": 0.65}
# of a typical bright voxel: less is no particle; leaves 3 of msa's 218 ghosts per 100 in `quick`
_FAINT = 0.01
_STEP, _BINS = 0.01, 4096  # levels of k that are tried, up to 41

Keep = Literal["reduced", "whole"]


def _level(value: object) -> object:
    if value == "auto" or (isinstance(value, float | int) and value >= 0):
        return value
    raise ValueError(f"expected auto or a number of at least 0, got {value!r}")


class ExtractionParameters(Parameters):
    """Parameters of the extraction of particles from a refocused plane."""

    k: Annotated[float | Literal["auto"], BeforeValidator(_level)] = Field(
        "auto",
        description="threshold = mean + k standard deviations of the plane: a higher k leaves "
        "fewer ghosts and faint particles; auto: by the share of the volume that particles fill",
    )
    keep: Keep = Field(
        "reduced", description="what stays of a value above the threshold: its excess, or all of it"
    )


def extract_particles(volume: F32, case: Observation, parameters: ExtractionParameters) -> F32:
    """Extract particles in place; `auto_k` chooses k if the parameters do not.

    Then what is far fainter than typical voxels of particles goes, too: `auto_k` leaves it for Q,
    to which it hardly matters, but each of it would count as a ghost.
    """
    if parameters.k != "auto":
        return extract(volume, parameters.k, parameters.keep)
    extract(volume, auto_k(volume, occupancy(case), parameters.keep), parameters.keep)
    means, spreads = plane_statistics(volume)
    typical = (means**2 + spreads**2).sum() / max(means.sum(), np.finfo(np.float32).tiny)
    volume[volume < _FAINT * typical] = 0.0
    return volume


def extract(volume: F32, k: float, keep: Keep) -> F32:
    """Zero all that is below mean + k std of its plane.

    Works in place on (z, y, x) and returns it. Source: thesis section 2.2.3; whether the threshold
    is subtracted is not stated there, so both are offered.
    """
    means, spreads = plane_statistics(volume)
    thresholds = (means + k * spreads).astype(np.float32)
    bases = thresholds if keep == "reduced" else np.zeros_like(thresholds)
    on_cores(_cut, len(volume), volume, thresholds, bases)
    return volume


def occupancy(case: Observation) -> float:
    """Estimate the share of the grid's voxels that particles fill, from images alone.

    It is (sum E)^2 / (n sum E^2) of a perfect reconstruction E.

    n particles that differ in relative brightness b alone give images of (mean)^2 / variance = n A
    <b>^2 / (<b^2> pixels), however they overlap (Campbell's theorem), with A the effective area of
    a particle's image; the volume's share follows with an effective volume A w in place of A, w
    being a particle's effective depth in voxels. Assumed are a dark background, light from the
    grid's particles only, and voxels as long along x as a pixel or, if they are not, particles as
    wide in voxels as in pixels, as E_s has them. The median camera counts.
    """
    good = case.repaired
    shares = []
    for image, covered in zip(good.images, good.flaws.covered, strict=True):
        mean, pixels = float(image[~covered].mean()), image.size - int(covered.sum())
        light = mean - float(case.black_dn)
        products = _products(np.where(covered, mean, image), mean)
        square, across, down = (product * image.size / pixels for product in products)
        variance = square / image.size
        if not variance > 0.0:
            shares.append(0.0)
            continue
        rows, columns = image.shape
        pairs = across / (rows * (columns - 1)) + down / ((rows - 1) * columns)
        beside = min(max(pairs / (2.0 * variance), 1e-3), 0.999)
        # of a Gaussian averaged over pixels
        sigma_px = math.sqrt(max(-0.25 / math.log(beside) - 1.0 / 12.0, 0.01))
        depth = effective_width(sigma_px * case.grid.voxel_mm[0] / case.grid.voxel_mm[2])
        shares.append(float(light**2 / variance * image.size * depth / math.prod(case.grid.shape)))
    return float(np.median(shares))


@numba.njit(cache=True)
def _products(image: Any, mean: float) -> Any:
    """Sum squares of an image less its mean, and products with neighbours.

    The neighbours are the pixels right and below.
    """
    square = across = down = 0.0
    for row in range(image.shape[0]):
        line, below = image[row], image[min(row + 1, image.shape[0] - 1)]
        for i in range(image.shape[1]):
            value = line[i] - mean
            square += value * value
            if i + 1 < image.shape[1]:
                across += value * (line[i + 1] - mean)
            if row + 1 < image.shape[0]:
                down += value * (below[i] - mean)
    return square, across, down


def auto_k(volume: F32, share: float, keep: Keep) -> float:
    """Find the k >= 0 that makes `extract` fill the given share of the volume.

    The result is accurate to 0.01 and at most 41; the volume (z, y, x) is not changed. On 196 data
    sets of 4 to 25 cameras, Q is on the average 0.005 to 0.012 below that of the best k.

    Parameters
    ----------
    share : `occupancy`; the field aims at 0.85 (reduced) or 0.65 (whole) of it.
    """
    (means, spreads), least = plane_statistics(volume), np.finfo(np.float32).tiny
    sums = np.zeros((len(volume), _BINS, 3))
    scales = 1.0 / (_STEP * np.maximum(spreads, least))
    on_cores(_sum_bins, len(volume), volume, means, scales, sums)
    # of all that lies above each level
    count, light, square = np.moveaxis(np.cumsum(sums[:, ::-1], axis=1)[:, ::-1], 2, 0)
    levels = _STEP * np.arange(_BINS)
    base = means[:, None] + levels * spreads[:, None] if keep == "reduced" else np.zeros_like(light)
    left = (light - base * count).sum(axis=0)
    filled = left**2 / np.maximum((square - base * (2.0 * light - base * count)).sum(axis=0), least)
    enough = np.flatnonzero(filled <= _SHARE[keep] * share * volume.size)
    return float(levels[enough[0]]) if len(enough) else float(levels[-1])


def plane_statistics(volume: F32) -> tuple[F64, F64]:
    """Compute mean and standard deviation of every plane."""
    sums = np.zeros((len(volume), 2))
    on_cores(_sum_squares, len(volume), volume, sums)
    means = sums[:, 0] / volume[0].size
    return means, np.sqrt(np.maximum(sums[:, 1] / volume[0].size - means**2, 0.0))


@numba.njit(cache=True, nogil=True)
def _sum_squares(jobs: slice, volume: Any, sums: Any) -> None:
    for plane in range(jobs.start, jobs.stop):
        for row in volume[plane]:
            light = square = 0.0
            for value in row:
                wide = np.float64(value)
                light += wide
                square += wide * wide
            sums[plane, 0] += light
            sums[plane, 1] += square


@numba.njit(cache=True, nogil=True)
def _cut(jobs: slice, volume: Any, thresholds: Any, bases: Any) -> None:
    for plane in range(jobs.start, jobs.stop):
        for row in volume[plane]:
            for i in range(len(row)):
                row[i] = row[i] - bases[plane] if row[i] > thresholds[plane] else np.float32(0.0)


@numba.njit(cache=True, nogil=True)
def _sum_bins(jobs: slice, volume: Any, means: Any, scales: Any, sums: Any) -> None:
    """Fill in sums[plane, i]: number, sum and sum of squares of voxels in bins of k.

    Bin i begins i steps of k above the mean; the last bin holds all above.
    """
    last = sums.shape[1] - 1
    for plane in range(jobs.start, jobs.stop):
        for row in volume[plane]:
            for value in row:
                if value > means[plane]:
                    entry = sums[plane, int(min((value - means[plane]) * scales[plane], last))]
                    wide = np.float64(value)
                    entry[0] += 1.0
                    entry[1] += wide
                    entry[2] += wide * wide
