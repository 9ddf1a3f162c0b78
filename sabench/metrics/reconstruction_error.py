"""Errors of a reconstructed volume: quality factor, particles, intensities."""

from __future__ import annotations

from collections.abc import Sequence

from sabench.api import Reconstruction
from sabench.api.truth import Particles, View
from sabench.geometry.grid import Grid
from sabench.metrics.blob_intensity import intensity_error
from sabench.metrics.particle_detection import (
    MATCHING_DISTANCES,
    Counts,
    count_challenge,
    count_thesis,
    detect,
    detect_peaks,
    f1_over_distance,
)
from sabench.metrics.quality_factor import quality
from sabench.metrics.synthesised_field import brightness, true_field
from sabench.utils import memory
from sabench.utils.arrays import F64

_DETECTION = ("true_percent", "ghost_percent", "precision", "recall", "rms_px")
SCORES = ("q", "peak_f1", "intensity_error", *_DETECTION, *(f"peak_{key}" for key in _DETECTION))


def score_frame(
    grid: Grid, particles: Particles, views: Sequence[View], estimate: Reconstruction
) -> dict[str, float | None]:
    """Score one frame's estimate against its true particles; the keys are `SCORES`."""
    truth = grid.to_voxels(particles.position_mm)
    detected, peaks = _particles(grid, estimate)
    own, other = _counts(grid, detected, truth), _counts(grid, peaks, truth)
    light = intensity_error(estimate.volume, peaks, truth, brightness(views), grid.in_scored(truth))
    memory.trim()
    q = quality(estimate.volume[grid.scored], true_field(grid, particles, views)[grid.scored])
    return {
        "q": q,
        "peak_f1": other[1].f1,
        "intensity_error": light,
        **_figures(*own),
        **{f"peak_{key}": value for key, value in _figures(*other).items()},
    }


def peak_f1_over_distance(grid: Grid, particles: Particles, estimate: Reconstruction) -> F64:
    """Compute peak F1 as a curve over the matching distances of `MATCHING_DISTANCES`."""
    truth, peaks = grid.to_voxels(particles.position_mm), _peaks(grid, estimate)
    scored = grid.in_scored(peaks), grid.in_scored(truth)
    return f1_over_distance(peaks, truth, *scored, MATCHING_DISTANCES)


def _particles(grid: Grid, estimate: Reconstruction) -> tuple[F64, F64]:
    """Detect particles (n, 3), in voxels, as components and as peaks.

    Where the estimate itself lists particles, both are that list.
    """
    peaks = _peaks(grid, estimate)
    return (detect(estimate.volume) if estimate.particles_mm is None else peaks), peaks


def _peaks(grid: Grid, estimate: Reconstruction) -> F64:
    if estimate.particles_mm is None:
        return detect_peaks(estimate.volume)
    return grid.to_voxels(estimate.particles_mm)


def _counts(grid: Grid, estimate: F64, truth: F64) -> tuple[Counts, Counts]:
    """Count particles by the thesis's and the challenge's rule; both in voxels."""
    pair = (estimate, truth, grid.in_scored(estimate), grid.in_scored(truth))
    return count_thesis(*pair), count_challenge(*pair)


def _figures(thesis: Counts, challenge: Counts) -> dict[str, float | None]:
    """Name the detection figures of both rules."""
    figures = (
        thesis.true_percent,
        thesis.ghost_percent,
        challenge.precision,
        challenge.recall,
        challenge.rms,
    )
    return dict(zip(_DETECTION, figures, strict=True))
