"""Multi-pass window correlation on volumes deformed by the last pass's field.

Narrow particles are first blurred, so that splines can resolve them between voxels. Invalid vectors
are found and replaced between passes.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter, median_filter

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
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores

_REACH = 3.0  # standard deviations of a Gaussian that count
_FLOOR = 0.1  # voxels: a fluctuation that any measurement has; Westerweel and Scarano (2005)


def within_deviations(shift: F64, valid: Bool, deviations: float) -> Bool:
    """Mark vectors (z, y, x, 3) near the mean of all valid ones."""
    if not valid.any():
        return valid
    vectors = shift[valid]
    near = np.abs(shift - vectors.mean(axis=0)) <= deviations * vectors.std(axis=0) + _FLOOR
    return np.asarray(valid & near.all(axis=-1))


def near_the_median(shift: F64, valid: Bool, times: float) -> Bool:
    """Mark vectors near the median of their 26 neighbours.

    Near means at most `times` the median of these neighbours' own distances from it. Beyond the
    edges fields are extrapolated linearly; otherwise the median would be biased inwards there.
    Source: J. Westerweel and F. Scarano, Universal outlier detection for PIV data, Exp. Fluids 39,
    1096-1100, 2005, in three dimensions.
    """
    around = np.where(valid[..., None], shift, np.nan)
    padding = [(min(1, count - 1),) * 2 for count in shift.shape[:3]]
    padded = np.pad(around, [*padding, (0, 0)], mode="reflect", reflect_type="odd")
    margin = [*((1 - before,) * 2 for before, _ in padding), (0, 0)]
    padded = np.pad(padded, margin, constant_values=np.nan)
    middle, spread = np.empty_like(shift), np.empty_like(shift)
    on_cores(medians, math.prod(middle.shape[:2]), padded, middle, spread)
    # never far, where there are no neighbours
    usual = np.linalg.norm(spread, axis=-1) + _FLOOR
    far = np.linalg.norm(shift - middle, axis=-1) > times * usual
    return np.asarray(valid & ~far)


def fill_invalid(shift: F64, valid: Bool) -> F64:
    """Replace invalid vectors by means of valid neighbours, or 0 if none is."""
    out, done = np.where(valid[..., None], shift, 0.0), valid.copy()
    if not done.any():
        return out
    while not done.all():
        total, count = _around(out * done[..., None]), _around(done[..., None].astype(np.float64))
        fresh = ~done & (count[..., 0] > 0.5)
        out[fresh] = total[fresh] / count[fresh]
        done |= fresh
    return out


def _around(values: F64) -> F64:
    """Sum over the 3 x 3 x 3 nearest, with zeros beyond the edges."""
    for axis in range(3):
        padded = np.pad(values, [(int(n == axis),) * 2 for n in range(values.ndim)])
        count = values.shape[axis]
        before, middle, after = (np.take(padded, range(n, n + count), axis) for n in range(3))
        values = middle + after + before
    return values


def smooth_vectors(shift: F64, sigma: tuple[float, float, float]) -> F64:
    """Smooth vectors by a Gaussian (z, y, x), extrapolated linearly at edges."""
    radii = [math.ceil(_REACH * width) for width in sigma]
    counts = shift.shape[:3]
    margins = [min(radius, count - 1) for radius, count in zip(radii, counts, strict=True)]
    padding = [*((margin, margin) for margin in margins), (0, 0)]
    wide = np.moveaxis(np.pad(shift, padding, mode="reflect", reflect_type="odd"), -1, 0)
    inner = tuple(slice(margin, margin + n) for margin, n in zip(margins, counts, strict=True))
    smooth = [gaussian_filter(axis, sigma, mode="nearest", radius=radii)[inner] for axis in wide]
    return np.stack(smooth, axis=-1)


def thesis_local(shift: F64, valid: Bool, deviations: float) -> Bool:
    """Mark vectors near their 3 x 3 x 3 median (thesis, section 2.3.3)."""
    ok = valid.copy()
    for axis in range(3):
        part = shift[..., axis]
        middle = median_filter(part, 3, mode="nearest")
        mean, square = (
            _around(values[..., None])[..., 0] / _around(np.ones((*part.shape, 1)))[..., 0]
            for values in (part, part**2)
        )
        ok &= (
            np.abs(part - middle) <= deviations * np.sqrt(np.maximum(square - mean**2, 0.0)) + 1e-12
        )
    return ok


@numba.njit(cache=True, nogil=True)
def medians(jobs: slice, padded: Any, middle: Any, spread: Any) -> None:
    """Fill in the medians of every vector's 26 neighbours, component by component.

    Also fills in the medians of these neighbours' distances from them.

    Parameters
    ----------
    padded : (z + 2, y + 2, x + 2, 3) with NaN for vectors that do not count; where none does, both
        medians are NaN.
    middle, spread : (z, y, x, 3).
    """
    _, high, wide = middle.shape[:3]
    for job in range(jobs.start, jobs.stop):
        z, y = job // high, job % high
        values = np.empty(26)
        for x in range(wide):
            for axis in range(3):
                count = 0
                for k in range(3):
                    for j in range(3):
                        for i in range(3):
                            value = padded[z + k, y + j, x + i, axis]
                            if (k != 1 or j != 1 or i != 1) and not np.isnan(value):
                                values[count] = value
                                count += 1
                half = _median(values, count)
                for n in range(count):
                    values[n] = abs(values[n] - half)
                middle[z, y, x, axis], spread[z, y, x, axis] = half, _median(values, count)


@inner_kernel()
def _median(values: Any, count: int) -> Any:
    """Compute the median of the first values, which are left in order."""
    if count == 0:
        return np.nan
    for n in range(1, count):
        value, slot = values[n], n
        while slot > 0 and values[slot - 1] > value:
            values[slot] = values[slot - 1]
            slot -= 1
        values[slot] = value
    return 0.5 * (values[(count - 1) // 2] + values[count // 2])


Widths = tuple[float, float, float]


def widths(volume: F32) -> Widths:
    """Estimate the particles' widths (z, y, x) in voxels as Gaussian sigmas.

    The estimate uses the volume's autocorrelation at a shift of one voxel: randomly placed
    Gaussians are correlated like exp(-s^2 / (4 sigma^2)) over a shift s.
    """
    mean = float(volume.mean(dtype=np.float64))
    variance = _inner(volume, volume) / volume.size - mean**2
    sigmas = []
    for axis in range(3):
        lines = np.moveaxis(volume, axis, 0)
        later, earlier = (np.moveaxis(part, 0, axis) for part in (lines[1:], lines[:-1]))
        shifted = _inner(later, earlier) / later.size - mean**2 if later.size else math.inf
        if variance <= 0.0 or shifted >= variance:
            sigmas.append(math.inf)  # it does not change from one voxel to the next
        else:
            sigmas.append(0.5 / math.sqrt(-math.log(max(shifted / variance, 1e-6))))
    return sigmas[0], sigmas[1], sigmas[2]


def _inner(first: F32, second: F32) -> float:
    return math.fsum(float(np.einsum("yx,yx->", a, b)) for a, b in zip(first, second, strict=True))


def widen(volume: F32, given: Widths, least: float) -> F32:
    """Blur the volume (z, y, x) by Gaussians along axes of too narrow particles."""
    sigma = [math.sqrt(max(0.0, least**2 - width**2)) for width in given]
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
class MultipassPlan:
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


def evaluate(first: F32, second: F32, plan: MultipassPlan) -> Field:
    """Evaluate displacements between two volumes (z, y, x)."""
    pairs = zip(widths(first), widths(second), strict=True)
    z, y, x = (0.5 * (width + other) for width, other in pairs)
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
        lead = smooth_vectors(field.shift, (z, y, x)) if plan.smoothing else field.shift
        lattice = field.windows.origin, tuple(float(part) for part in field.windows.step)
        rows = math.prod(first.shape[:2])
        on_cores(deform_pair, rows, *coefficients, lead, *lattice, *warped)
        peaks = by_shifts(warped[0], warped[1], windows, plan.search, plan.taper)
        peaks.shift[:] += _at(lead, field.windows, windows)
        field = _validate(windows, peaks, peaks.height >= plan.height, plan)
    return field


def evaluate_once(first: F32, second: F32, size: Size, overlap: float, ratio: float) -> Field:
    """Evaluate one pass of spectra on fixed windows (thesis, section 2.3.3)."""
    windows = Windows.over(first.shape, size, overlap)
    peaks = by_spectra(first, second, windows)
    assert peaks.ratio is not None
    clear = np.asarray((peaks.ratio >= ratio) & (peaks.height > 0.0))
    valid = within_deviations(peaks.shift, clear, 5.0)
    valid = thesis_local(fill_invalid(peaks.shift, valid), valid, 3.0)
    return Field(windows, smooth_vectors(fill_invalid(peaks.shift, valid), (_KERNEL,) * 3), valid)


def _validate(windows: Windows, peaks: CorrelationPeaks, valid: Bool, plan: MultipassPlan) -> Field:
    valid = within_deviations(peaks.shift, valid, 5.0)
    valid = near_the_median(peaks.shift, valid, plan.median)
    return Field(windows, fill_invalid(peaks.shift, valid), valid)


def _at(values: F64, source: Windows, here: Windows) -> F64:
    """Interpolate a field from some windows' middles to others'.

    Beyond the middles, it is extrapolated linearly.
    """
    for axis in range(3):
        place = here.origin[axis] + here.step[axis] * np.arange(here.counts[axis])
        position = (place - source.origin[axis]) / source.step[axis]
        low = np.clip(position.astype(int), 0, max(source.counts[axis] - 2, 0))
        part = np.expand_dims(position - low, tuple(n for n in range(values.ndim) if n != axis))
        high = np.minimum(low + 1, source.counts[axis] - 1)
        values = np.take(values, low, axis) * (1.0 - part) + np.take(values, high, axis) * part
    return values
