"""Multi-pass window correlation on volumes deformed by the last pass's field.

Narrow particles are first blurred, so that splines can resolve them between voxels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sabench.algorithms.velocimetry import outliers
from sabench.algorithms.velocimetry.deformation import deform_pair, spline_coefficients
from sabench.algorithms.velocimetry.windows import (
    CorrelationPeaks,
    Size,
    Windows,
    by_shifts,
    by_spectra,
)
from sabench.api import Velocity
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32, F64, Bool, triple
from sabench.utils.progress import progress_bar

Widths = tuple[float, float, float]
_REACH = 3.0  # standard deviations of a Gaussian that count


def widths(volume: F32) -> Widths:
    """Estimate the particles' widths (z, y, x) in voxels as Gaussian sigmas.

    The estimate uses the volume's autocorrelation at a shift of one voxel: randomly placed
    Gaussians are correlated like exp(-s^2 / (4 sigma^2)) over a shift s.
    """
    mean = float(volume.mean(dtype=np.float64))
    variance = _inner(volume, volume) / volume.size - mean**2
    found = []
    for axis in range(3):
        lines = np.moveaxis(volume, axis, 0)
        one, other = (np.moveaxis(part, 0, axis) for part in (lines[1:], lines[:-1]))
        shifted = _inner(one, other) / one.size - mean**2 if one.size else math.inf
        if variance <= 0.0 or shifted >= variance:
            found.append(math.inf)  # it does not change from one voxel to the next
        else:
            found.append(0.5 / math.sqrt(-math.log(max(shifted / variance, 1e-6))))
    return found[0], found[1], found[2]


def _inner(one: F32, other: F32) -> float:
    return math.fsum(float(np.einsum("yx,yx->", a, b)) for a, b in zip(one, other, strict=True))


def widen(volume: F32, given: Widths, least: float) -> F32:
    """Blur the volume (z, y, x) by Gaussians along axes of too narrow particles."""
    sigma = [math.sqrt(max(0.0, least**2 - own**2)) for own in given]
    if not any(sigma):
        return volume
    out = _blur(volume.reshape(len(volume), -1), sigma[0], 0.0).reshape(volume.shape)
    return np.stack([_blur(plane, sigma[1], sigma[2]) for plane in out])


def _blur(plane: F32, down: float, across: float) -> F32:
    kernels = []
    for sigma in (across, down):
        reach = math.ceil(_REACH * sigma)
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-9)) ** 2)
        kernels.append(np.asarray(weights / weights.sum(), dtype=np.float32))
    along, down_weights = kernels
    border = cv2.BORDER_REFLECT_101
    return np.asarray(cv2.sepFilter2D(plane, cv2.CV_32F, along, down_weights, borderType=border))


# in vectors: the Gaussian of matPIV's 3 x 3 x 3 kernel; what it weighs beyond that is under 1 %
_KERNEL = 0.65


@dataclass(frozen=True)
class Plan:
    """Settings of the evaluation of a pair of volumes.

    Attributes
    ----------
    first, last : windows (z, y, x) of the first pass, by spectra, and of the later ones, by shifts.
    overlap : of the windows, as a part of them; the first pass overlaps by half.
    passes : after the first.
    search : largest shift (z, y, x) of a later pass.
    ratio, height : least peak ratio of the first pass, and normalised correlation of the last one.
    median : of the test against neighbours.
    smoothing : standard deviation of the Gaussian on the field that moves the volumes, in windows.
    width : least standard deviation of particles, voxels; narrower ones, which splines cannot
        resolve, are blurred.
    taper : standard deviation of the later windows' Gaussian weights, in windows, or None.
    """

    first: Size
    last: Size
    overlap: float
    passes: int
    search: Size
    ratio: float
    height: float
    median: float
    smoothing: float
    width: float
    taper: float | None


@dataclass(frozen=True)
class Field:
    """Displacements (z, y, x, 3) at windows, in voxels (x, y, z), and validity.

    Valid ones were measured.
    """

    windows: Windows
    shift: F64
    valid: Bool

    def on_grid(self, grid: Grid, interval_s: float) -> Velocity:
        """Convert to velocities in the world."""
        voxel = np.asarray(grid.voxel_mm)
        lattice = self.windows.origin, self.windows.step
        start, step = (np.asarray(values[::-1]) for values in lattice)
        low = triple(np.asarray(grid.low_mm) + voxel * start)
        return Velocity(low, triple(voxel * step), self.shift * voxel / interval_s, self.valid)


def evaluate(first: F32, second: F32, plan: Plan) -> Field:
    """Evaluate displacements between two volumes (z, y, x)."""
    pairs = zip(widths(first), widths(second), strict=True)
    z, y, x = (0.5 * (one + other) for one, other in pairs)
    first, second = (widen(volume, (z, y, x), plan.width) for volume in (first, second))
    coarse = Windows.over(first.shape, plan.first, 0.5)
    peaks = by_spectra(first, second, coarse)
    assert peaks.ratio is not None
    field = _validate(coarse, peaks, (peaks.ratio >= plan.ratio) & (peaks.height > 0.0), plan)
    windows = Windows.over(first.shape, plan.last, plan.overlap)
    coefficients = spline_coefficients(first), spline_coefficients(second)
    warped = np.empty_like(first), np.empty_like(second)
    for _ in progress_bar(range(plan.passes), "move and correlate"):
        sizes = zip(plan.last, field.windows.step, strict=True)
        z, y, x = (plan.smoothing * size / step for size, step in sizes)
        lead = outliers.smooth_vectors(field.shift, (z, y, x)) if plan.smoothing else field.shift
        lattice = field.windows.origin, tuple(float(part) for part in field.windows.step)
        deform_pair(*coefficients, lead, *lattice, *warped)
        peaks = by_shifts(warped[0], warped[1], windows, plan.search, plan.taper)
        peaks.shift[:] += _at(lead, field.windows, windows)
        field = _validate(windows, peaks, peaks.height >= plan.height, plan)
    return field


def evaluate_once(first: F32, second: F32, size: Size, overlap: float, ratio: float) -> Field:
    """Evaluate one pass of spectra on fixed windows.

    The thesis does so in section 2.3.3.
    """
    windows = Windows.over(first.shape, size, overlap)
    peaks = by_spectra(first, second, windows)
    assert peaks.ratio is not None
    clear = np.asarray((peaks.ratio >= ratio) & (peaks.height > 0.0))
    valid = outliers.within_deviations(peaks.shift, clear, 5.0)
    valid = outliers.thesis_local(outliers.fill_invalid(peaks.shift, valid), valid, 3.0)
    return Field(
        windows,
        outliers.smooth_vectors(outliers.fill_invalid(peaks.shift, valid), (_KERNEL,) * 3),
        valid,
    )


def _validate(windows: Windows, peaks: CorrelationPeaks, valid: Bool, plan: Plan) -> Field:
    valid = outliers.within_deviations(peaks.shift, valid, 5.0)
    valid = outliers.near_the_median(peaks.shift, valid, plan.median)
    return Field(windows, outliers.fill_invalid(peaks.shift, valid), valid)


def _at(values: F64, there: Windows, here: Windows) -> F64:
    """Interpolate a field from some windows' middles to others'.

    Beyond the middles, it is extrapolated linearly.
    """
    for axis in range(3):
        place = here.origin[axis] + here.step[axis] * np.arange(here.counts[axis])
        position = (place - there.origin[axis]) / there.step[axis]
        low = np.clip(position.astype(int), 0, max(there.counts[axis] - 2, 0))
        part = np.expand_dims(position - low, tuple(n for n in range(values.ndim) if n != axis))
        high = np.minimum(low + 1, there.counts[axis] - 1)
        values = np.take(values, low, axis) * (1.0 - part) + np.take(values, high, axis) * part
    return values
