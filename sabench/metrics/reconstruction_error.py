"""Errors of a reconstructed volume: quality factor, and particles found in it."""

from __future__ import annotations

from collections.abc import Sequence

from sabench.api import Reconstruction
from sabench.api.truth import Particles, View
from sabench.geometry.grid import Grid
from sabench.metrics.particle_detection import count_challenge, count_thesis, detect, detect_peaks
from sabench.metrics.quality_factor import quality
from sabench.metrics.synthesised_field import true_field
from sabench.utils import memory
from sabench.utils.arrays import F64

_DETECTION = ("true_percent", "ghost_percent", "precision", "recall", "rms_px")
SCORES = ("q", *_DETECTION, *(f"peak_{key}" for key in _DETECTION))


def score_frame(
    grid: Grid, particles: Particles, views: Sequence[View], estimate: Reconstruction
) -> dict[str, float | None]:
    """Score one frame's estimate against its true particles; the keys are `SCORES`."""
    truth = grid.to_voxels(particles.position_mm)
    components, peaks = (_count(grid, one, truth) for one in _particles(grid, estimate))
    memory.trim()
    q = quality(estimate.volume[grid.scored], true_field(grid, particles, views)[grid.scored])
    return {"q": q, **components, **{f"peak_{key}": value for key, value in peaks.items()}}


def _particles(grid: Grid, estimate: Reconstruction) -> tuple[F64, F64]:
    """Detect particles (n, 3), in voxels, as components and as peaks.

    Where the estimate itself lists particles, both are that list.
    """
    if estimate.particles_mm is None:
        return detect(estimate.volume), detect_peaks(estimate.volume)
    given = grid.to_voxels(estimate.particles_mm)
    return given, given


def _count(grid: Grid, estimate: F64, truth: F64) -> dict[str, float | None]:
    """Compute the detection figures of particles against true ones, in voxels."""
    pair = (estimate, truth, grid.in_scored(estimate), grid.in_scored(truth))
    thesis, challenge = count_thesis(*pair), count_challenge(*pair)
    figures = (
        thesis.true_percent,
        thesis.ghost_percent,
        challenge.precision,
        challenge.recall,
        challenge.rms,
    )
    return dict(zip(_DETECTION, figures, strict=True))
