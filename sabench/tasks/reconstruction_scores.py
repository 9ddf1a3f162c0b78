"""Scores of a result against a data set's truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.api import Reconstruction
from sabench.api.truth import Particles, View
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.geometry.grid import Grid, synthesise
from sabench.metrics.particle_detection import count_challenge, count_thesis, detect, detect_peaks
from sabench.metrics.quality_factor import quality
from sabench.utils import memory
from sabench.utils.arrays import F32, F64

_DETECTION = ("true_percent", "ghost_percent", "precision", "recall", "rms_px")
SCORES = ("q", *_DETECTION, *(f"peak_{key}" for key in _DETECTION))


def true_field(grid: Grid, particles: Particles, views: Sequence[View]) -> F32:
    """The synthesised field E_s (z, y, x) of a frame.

    Every particle, seen or not, is a sphere in mm: peak = its `brightness`, standard deviation =
    the median image size, carried from pixels to mm by the grid's x spacing.
    """
    if not len(particles):
        return np.zeros(grid.shape, dtype=np.float32)
    sigma_px = float(np.nanmedian(np.concatenate([view.sigma_px for view in views])))
    return synthesise(grid, particles.position_mm, brightness(views), sigma_px * grid.voxel_mm[0])


def brightness(views: Sequence[View]) -> F64:
    """Each particle's photons relative to the mean of all lit particles in a camera, mean over the cameras in which it is lit; 0 if in none."""
    photons = np.stack([view.photons for view in views])
    lit = photons > 0.0
    typical = photons.sum(axis=1) / np.maximum(lit.sum(axis=1), 1)
    relative = photons / np.maximum(typical, 1e-300)[:, None]
    return np.asarray(relative.sum(axis=0) / np.maximum(lit.sum(axis=0), 1))


def estimate(dataset: Dataset, result: Result | str, frame: int) -> Reconstruction:
    """The estimate of a frame: a result's, or the one that the word `truth` or `empty` stands for."""
    if isinstance(result, Result):
        return result.reconstruction(frame)
    if result == "truth":
        particles = dataset.particles(frame)
        return Reconstruction(
            true_field(dataset.rig.grid, particles, dataset.views(frame)), particles.position_mm
        )
    return Reconstruction(np.zeros(dataset.rig.grid.shape, dtype=np.float32))


def score_frame(
    grid: Grid, particles: Particles, views: Sequence[View], guess: Reconstruction
) -> dict[str, float | None]:
    """All scores of one frame's estimate, from truth in memory."""
    truths = grid.to_voxels(particles.position_mm)
    components, peaks = (_count(grid, found, truths) for found in _found(grid, guess))
    memory.trim()
    q = quality(guess.volume[grid.scored], true_field(grid, particles, views)[grid.scored])
    return {"q": q, **components, **{f"peak_{key}": value for key, value in peaks.items()}}


def _found(grid: Grid, guess: Reconstruction) -> tuple[F64, F64]:
    """Particles in voxels, as components and as peaks of the volume, unless the estimate itself lists them."""
    if guess.particles_mm is None:
        return detect(guess.volume), detect_peaks(guess.volume)
    given = grid.to_voxels(guess.particles_mm)
    return given, given


def _count(grid: Grid, found: F64, truths: F64) -> dict[str, float | None]:
    """The five figures of detections against truths, both in voxels."""
    pair = (found, truths, grid.in_scored(found), grid.in_scored(truths))
    thesis, challenge = count_thesis(*pair), count_challenge(*pair)
    figures = (
        thesis.true_percent,
        thesis.ghost_percent,
        challenge.precision,
        challenge.recall,
        challenge.rms,
    )
    return dict(zip(_DETECTION, figures, strict=True))
