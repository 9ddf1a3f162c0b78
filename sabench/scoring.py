"""Scores of a result against a data set's truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sabench import memory
from sabench.api import Reconstruction
from sabench.arrays import F32
from sabench.dataset.read import Dataset, View, open_dataset
from sabench.dataset.result import Result, open_result
from sabench.metrics.detection import count_challenge, count_thesis, detect
from sabench.metrics.quality import quality
from sabench.progress import track
from sabench.volume import Grid, synthesise
from sabench.world import Particles

SCORES = ("q", "true_percent", "ghost_percent", "precision", "recall", "rms_px")


def score(dataset: Dataset | str | Path, result: str | Path) -> dict[str, Any]:
    """Score a result file, or one of the words `truth` and `empty`, the two ends of every scale.

    Returns
    -------
    A flat dict: dataset, solver, parameters, q, true_percent, ghost_percent, precision, recall, rms_px, seconds, peak_mb; None where a
    figure does not apply. Several frames: the mean over the frames that have the figure.

    Raises
    ------
    InputError
        A file that is not a result of this data set, or has a wrong shape or values that are not finite.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    opened = None if str(result) in ("truth", "empty") else open_result(result, data)
    frames = [
        score_frame(data.rig.grid, data.particles(frame), data.views(frame), estimate(data, opened or str(result), frame))
        for frame in track(range(data.rig.frames), "score")
    ]
    means = {key: _mean([frame[key] for frame in frames]) for key in SCORES}
    head = {"dataset": data.content_hash, "solver": opened.solver if opened else str(result), "parameters": opened.parameters if opened else {}}
    return {**head, **means, "seconds": opened.seconds if opened else None, "peak_mb": opened.peak_mb if opened else None}


def true_field(grid: Grid, particles: Particles, views: Sequence[View]) -> F32:
    """The synthesised field E_s (z, y, x) of a frame.

    Every particle, seen or not, is a sphere in mm: peak = its brightness (mean over the cameras, in each relative to that
    camera's mean), standard deviation = the median image size, carried from pixels to mm by the grid's x spacing.
    """
    if not len(particles):
        return np.zeros(grid.shape, dtype=np.float32)
    bright = np.mean([view.photons / max(view.photons.mean(), 1e-300) for view in views], axis=0)
    sigma_px = float(np.nanmedian(np.concatenate([view.sigma_px for view in views])))
    return synthesise(grid, particles.position_mm, bright, sigma_px * grid.voxel_mm[0])


def estimate(dataset: Dataset, result: Result | str, frame: int) -> Reconstruction:
    """The estimate of a frame: a result's, or the one that the word `truth` or `empty` stands for."""
    if isinstance(result, Result):
        return result.reconstruction(frame)
    if result == "truth":
        particles = dataset.particles(frame)
        return Reconstruction(true_field(dataset.rig.grid, particles, dataset.views(frame)), particles.position_mm)
    return Reconstruction(np.zeros(dataset.rig.grid.shape, dtype=np.float32))


def score_frame(grid: Grid, particles: Particles, views: Sequence[View], guess: Reconstruction) -> dict[str, float | None]:
    """All scores of one frame's estimate, from truth in memory."""
    found = detect(guess.volume) if guess.particles_mm is None else grid.to_voxels(guess.particles_mm)
    truths = grid.to_voxels(particles.position_mm)
    memory.trim()
    pair = (found, truths, grid.in_scored(found), grid.in_scored(truths))
    thesis, challenge = count_thesis(*pair), count_challenge(*pair)
    return {
        "q": quality(guess.volume[grid.scored], true_field(grid, particles, views)[grid.scored]),
        "true_percent": thesis.true_percent, "ghost_percent": thesis.ghost_percent,
        "precision": challenge.precision, "recall": challenge.recall, "rms_px": challenge.rms,
    }  # fmt: skip


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
