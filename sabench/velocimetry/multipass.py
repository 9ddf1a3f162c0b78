"""Passes of window correlation, each on volumes that the last pass's field has brought nearer to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.arrays import F32, F64, Bool
from sabench.velocimetry.kernels import moved, spline_coefficients
from sabench.velocimetry.validation import filled, near_the_median, smoothed, within_deviations
from sabench.velocimetry.windows import Peaks, Windows, by_shifts, by_spectra

Size = tuple[int, int, int]


@dataclass(frozen=True)
class Plan:
    """How a pair of volumes is evaluated.

    Attributes
    ----------
    first, last : windows (z, y, x) of the first pass, by spectra, and of the later ones, by shifts.
    overlap : of the windows, as a part of them; the first pass overlaps by half.
    passes : after the first.
    reach : largest shift (z, y, x) that a later pass looks for.
    ratio, height : least peak ratio of the first pass, and least normalised correlation of the last one.
    median : of the test against neighbours.
    smoothing : standard deviation in vectors of the Gaussian on the field that moves the volumes.
    """

    first: Size
    last: Size
    overlap: float
    passes: int
    reach: Size
    ratio: float
    height: float
    median: float
    smoothing: float


@dataclass(frozen=True)
class Field:
    """Displacements at windows: (z, y, x, 3) in voxels (x, y, z), which of them were measured, and their correlation."""

    windows: Windows
    shift: F64
    valid: Bool
    height: F64


def evaluate(first: F32, second: F32, plan: Plan) -> Field:
    """Displacements between two volumes (z, y, x)."""
    coarse = Windows.over(first.shape, plan.first, 0.5)
    peaks = by_spectra(first, second, coarse)
    assert peaks.ratio is not None
    field = _checked(coarse, peaks, (peaks.ratio >= plan.ratio) & (peaks.height > 0.0), plan)
    windows = Windows.over(first.shape, plan.last, plan.overlap)
    coefficients = spline_coefficients(first), spline_coefficients(second)
    warped = np.empty_like(first), np.empty_like(second)
    for _ in range(plan.passes):
        lead = smoothed(field.shift, plan.smoothing) if plan.smoothing else field.shift
        for volume, share, out in zip(coefficients, (-0.5, 0.5), warped, strict=True):
            moved(volume, lead, field.windows.origin, tuple(float(part) for part in field.windows.step), share, out)
        peaks = by_shifts(warped[0], warped[1], windows, plan.reach)
        peaks.shift[:] += _at(lead, field.windows, windows)
        field = _checked(windows, peaks, peaks.height >= plan.height, plan)
    return field


def _checked(windows: Windows, peaks: Peaks, valid: Bool, plan: Plan) -> Field:
    valid = within_deviations(peaks.shift, valid, 5.0)
    valid = near_the_median(peaks.shift, valid, plan.median)
    return Field(windows, filled(peaks.shift, valid), valid, peaks.height)


def _at(values: F64, there: Windows, here: Windows) -> F64:
    """A field on some windows' middles, interpolated to others'."""
    for axis in range(3):
        place = (here.origin[axis] + here.step[axis] * np.arange(here.counts[axis]) - there.origin[axis]) / there.step[axis]
        place = np.clip(place, 0.0, there.counts[axis] - 1.0)
        low = np.minimum(place.astype(int), max(there.counts[axis] - 2, 0))
        part = np.expand_dims(place - low, tuple(n for n in range(values.ndim) if n != axis))
        high = np.minimum(low + 1, there.counts[axis] - 1)
        values = np.take(values, low, axis=axis) * (1.0 - part) + np.take(values, high, axis=axis) * part
    return values
