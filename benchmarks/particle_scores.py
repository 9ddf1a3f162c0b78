"""Scores of the particles of a frame in memory, as the task `particles` computes them.

Reconstruction solvers take part, too: their particles are the local maxima of their volumes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api import Camera, FoundParticles, ImageSequence, Observation
from sabench.images.position_bounds import position_bounds
from sabench.metrics.particle_bounds import coverage, rms_over_bound, true_spots
from sabench.metrics.particle_detection import challenge_pairs, count_challenge, detect_peaks
from sabench.scenes.sensor import Sensor
from sabench.simulation.in_memory import Shot
from sabench.utils.arrays import F64, I64, U16


@dataclass(frozen=True)
class Recording:
    """Images and sensor, on which bounds of positions depend next to the truth.

    Attributes
    ----------
    images : (camera, row, column) as recorded, before preprocessing.
    """

    images: U16
    sensor: Sensor


def why_skipped(solver: Any, case: Observation) -> str | None:
    """Return why a solver of either task does not take a frame."""
    reason: str | None = solver.skip(case if _makes_volumes(solver) else ImageSequence.of([case]))
    return reason


def find_particles(solver: Any, case: Observation) -> FoundParticles:
    """Find the particles of a frame by a solver of particles or of volumes."""
    if not _makes_volumes(solver):
        found: FoundParticles = next(iter(solver.solve(ImageSequence.of([case]))))
        return found
    estimate = solver.solve(case)
    if estimate.particles_mm is not None:
        return FoundParticles(estimate.particles_mm)
    voxels = detect_peaks(estimate.volume)
    return FoundParticles(np.asarray(case.grid.low_mm) + voxels * np.asarray(case.grid.voxel_mm))


def _makes_volumes(solver: Any) -> bool:
    return bool(solver.task == "reconstruction")


def score_particles(
    found: FoundParticles, shot: Shot, cameras: Sequence[Camera], recording: Recording | None
) -> dict[str, Any]:
    """Score particles by the true cameras; without a recording there are no bounds."""
    grid, true = shot.observation.grid, shot.particles.position_mm
    here, there = grid.to_voxels(found.position_mm), grid.to_voxels(true)
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    i, j = challenge_pairs(here, there)
    i, j = i[grid.in_scored(there[j])], j[grid.in_scored(there[j])]
    figures = {
        "recall": round(100.0 * counts.recall, 2),
        "ghosts": round(100.0 * (counts.detections - counts.matched) / counts.truths, 2),
        "f1": round(counts.f1, 4),
        "rms_px": None,
        "true": counts.truths,
    }
    if len(i):
        figures["rms_px"] = _apart_px(found.position_mm[i], true[j], cameras)
        figures |= _accuracy(found, shot, cameras, recording, (i, j))
    return figures


def _apart_px(found_mm: F64, true_mm: F64, cameras: Sequence[Camera]) -> float:
    """Compute the RMS distance of pairs of points in the images."""
    apart = [
        np.linalg.norm(camera.project(found_mm)[0] - camera.project(true_mm)[0], axis=1)
        for camera in cameras
    ]
    return round(float(np.sqrt(np.mean(np.square(apart)))), 4)


def _accuracy(
    found: FoundParticles,
    shot: Shot,
    cameras: Sequence[Camera],
    recording: Recording | None,
    pairs: tuple[I64, I64],
) -> dict[str, float]:
    """Compare the errors of pairs with what images allow and the result claims."""
    i, j = pairs
    error = found.position_mm[i] - shot.particles.position_mm[j]
    figures = {}
    if recording is not None:
        spots = true_spots(
            shot.particles.position_mm,
            shot.views,
            cameras,
            list(recording.images),
            recording.sensor,
        )
        figures["rms_over_bound"] = rms_over_bound(error, position_bounds(spots, j))
    if found.covariance_mm2 is not None:
        figures["coverage_68"] = coverage(error, found.covariance_mm2[i], 0.68)
        figures["coverage_95"] = coverage(error, found.covariance_mm2[i], 0.95)
    return {key: round(value, 3) for key, value in figures.items()}
