"""Blur of volumes, so that splines can resolve the particles between voxels.

blur: Blur of volumes, so that splines can resolve the particles between voxels.

multipass: Multi-pass window correlation on volumes deformed by the last pass's field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from sabench.algorithms.velocimetry.deformation import deform_pair, spline_coefficients
from sabench.algorithms.velocimetry.outliers import (
    fill_invalid,
    near_the_median,
    smooth_vectors,
    thesis_local,
    within_deviations,
)
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
    mean, total = float(volume.mean(dtype=np.float64)), _inner(volume, volume)
    z, y, x = (
        _width(_inner(one, other) / one.size - mean**2, total / volume.size - mean**2)
        if one.size
        else math.inf  # a single voxel along this axis
        for one, other in (
            (volume[1:], volume[:-1]),
            (volume[:, 1:], volume[:, :-1]),
            (volume[..., 1:], volume[..., :-1]),
        )
    )
    return z, y, x


def _inner(one: F32, other: F32) -> float:
    return math.fsum(float(np.einsum("yx,yx->", a, b)) for a, b in zip(one, other, strict=True))


def _width(shifted: float, own: float) -> float:
    if own <= 0.0 or shifted >= own:
        return math.inf  # it does not change from one voxel to the next
    return 0.5 / math.sqrt(-math.log(max(shifted / own, 1e-6)))


def widen(volume: F32, given: Widths, least: float) -> F32:
    """Blur the volume (z, y, x) where its particles are too narrow.

    A Gaussian along every such axis raises the given widths to the least one.
    """
    sigma = [math.sqrt(max(0.0, least**2 - own**2)) for own in given]
    if not any(sigma):
        return volume
    out = _blur(volume.reshape(len(volume), -1), sigma[0], 0.0).reshape(volume.shape)
    return np.stack([_blur(plane, sigma[1], sigma[2]) for plane in out])


def _blur(plane: F32, down: float, across: float) -> F32:
    """Blur a plane by a Gaussian down its columns and across its rows."""
    kernels = [_kernel(sigma) for sigma in (across, down)]
    return np.asarray(
        cv2.sepFilter2D(
            plane, cv2.CV_32F, kernels[0], kernels[1], borderType=cv2.BORDER_REFLECT_101
        )
    )


def _kernel(sigma: float) -> F32:
    offsets = np.arange(-math.ceil(_REACH * sigma), math.ceil(_REACH * sigma) + 1)
    weights = np.exp(-0.5 * (offsets / max(sigma, 1e-9)) ** 2)
    return np.asarray(weights / weights.sum(), dtype=np.float32)


# vectors: the Gaussian of matPIV's 3 x 3 x 3 kernel; what it weighs beyond that is under 1 %
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
    ratio, height : least peak ratio of the first pass, and least normalised correlation of the last
        one.
    median : of the test against neighbours.
    smoothing : standard deviation of the Gaussian on the field that moves the volumes, as a part of
        the later windows.
    width : least standard deviation in voxels of particles, to which narrower ones are blurred:
        splines cannot resolve these between voxels.
    taper : standard deviation of the Gaussian that weights the later windows, as a part of them;
        None: no weights.
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
    """Displacements at windows.

    (z, y, x, 3) in voxels (x, y, z), and which of them were measured.
    """

    windows: Windows
    shift: F64
    valid: Bool

    def on_grid(self, grid: Grid, interval_s: float) -> Velocity:
        """Convert to velocities in the world."""
        voxel = np.asarray(grid.voxel_mm)
        start, step = (
            np.asarray(values[::-1]) for values in (self.windows.origin, self.windows.step)
        )
        return Velocity(
            triple(np.asarray(grid.low_mm) + voxel * start),
            triple(voxel * step),
            self.shift * voxel / interval_s,
            self.valid,
        )


def evaluate(first: F32, second: F32, plan: Plan) -> Field:
    """Evaluate displacements between two volumes (z, y, x)."""
    own = widths(first), widths(second)
    mean = tuple(0.5 * (one + other) for one, other in zip(*own, strict=True))
    first, second = (
        widen(volume, (mean[0], mean[1], mean[2]), plan.width) for volume in (first, second)
    )
    coarse = Windows.over(_shape(first), plan.first, 0.5)
    peaks = by_spectra(first, second, coarse)
    assert peaks.ratio is not None
    field = _validate(coarse, peaks, (peaks.ratio >= plan.ratio) & (peaks.height > 0.0), plan)
    windows = Windows.over(_shape(first), plan.last, plan.overlap)
    coefficients = spline_coefficients(first), spline_coefficients(second)
    warped = np.empty_like(first), np.empty_like(second)
    for _ in progress_bar(range(plan.passes), "move and correlate"):
        z, y, x = (
            plan.smoothing * own / step
            for own, step in zip(plan.last, field.windows.step, strict=True)
        )
        lead = smooth_vectors(field.shift, (z, y, x)) if plan.smoothing else field.shift
        deform_pair(
            *coefficients,
            lead,
            field.windows.origin,
            tuple(float(part) for part in field.windows.step),
            *warped,
        )
        peaks = by_shifts(warped[0], warped[1], windows, plan.search, plan.taper)
        peaks.shift[:] += _at(lead, field.windows, windows)
        field = _validate(windows, peaks, peaks.height >= plan.height, plan)
    return field


def _shape(volume: F32) -> Size:
    z, y, x = volume.shape
    return z, y, x


def evaluate_once(first: F32, second: F32, size: Size, overlap: float, ratio: float) -> Field:
    """Evaluate one pass of spectra on fixed windows, filtered, filled and smoothed.

    The method is that of the thesis, section 2.3.3.
    """
    windows = Windows.over(_shape(first), size, overlap)
    peaks = by_spectra(first, second, windows)
    assert peaks.ratio is not None
    valid = within_deviations(
        peaks.shift, np.asarray((peaks.ratio >= ratio) & (peaks.height > 0.0)), 5.0
    )
    valid = thesis_local(fill_invalid(peaks.shift, valid), valid, 3.0)
    return Field(windows, smooth_vectors(fill_invalid(peaks.shift, valid), (_KERNEL,) * 3), valid)


def _validate(windows: Windows, peaks: CorrelationPeaks, valid: Bool, plan: Plan) -> Field:
    valid = within_deviations(peaks.shift, valid, 5.0)
    valid = near_the_median(peaks.shift, valid, plan.median)
    return Field(windows, fill_invalid(peaks.shift, valid), valid)


def _at(values: F64, there: Windows, here: Windows) -> F64:
    """Interpolate a field from some windows' middles to others'.

    Beyond the outer ones it is extrapolated linearly.
    """
    for axis in range(3):
        position = (
            here.origin[axis] + here.step[axis] * np.arange(here.counts[axis]) - there.origin[axis]
        ) / there.step[axis]
        low = np.clip(position.astype(int), 0, max(there.counts[axis] - 2, 0))
        part = np.expand_dims(position - low, tuple(n for n in range(values.ndim) if n != axis))
        high = np.minimum(low + 1, there.counts[axis] - 1)
        values = (
            np.take(values, low, axis=axis) * (1.0 - part) + np.take(values, high, axis=axis) * part
        )
    return values
