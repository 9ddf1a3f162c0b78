"""Estimates of the reconstruction task: a result's, or the best and worst possible ones."""

from __future__ import annotations

import numpy as np

from sabench.api import Reconstruction
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.metrics.synthesised_field import true_field


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
