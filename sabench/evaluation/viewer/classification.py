"""Classification of estimates by the rules of the scores."""

from __future__ import annotations

import numpy as np

from sabench.api import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.dataset.reader import Dataset
from sabench.evaluation.viewer.clouds import DUPLICATE, FOUND, GHOST, MISSED, TRUE, Cloud
from sabench.metrics.bubble_detection import AnyBubbles, match
from sabench.metrics.particle_detection import challenge_pairs, detect_peaks, mark_duplicates
from sabench.tasks.velocimetry import truth_at
from sabench.utils.arrays import F64, I64, U8


def true_particles(data: Dataset, frame: int) -> Cloud:
    """Read the true particles of a frame."""
    true = data.particles(frame)
    return Cloud.of_kind(true.position_mm, TRUE, true.id, true.velocity_mm_s)


def true_bubbles(data: Dataset, frame: int) -> Cloud:
    """Read the true bubbles of a frame."""
    true = data.bubbles(frame)
    return Cloud.of_kind(true.center_mm, TRUE, true.id, true.velocity_mm_s, _shapes(true))


def target_points(data: Dataset, frame: int) -> Cloud:
    """Read the true points of a calibration target."""
    points = data.placed().points_mm[frame]
    return Cloud.of_kind(points, TRUE)


def classify_particles(found: FoundParticles, data: Dataset, frame: int) -> Cloud:
    """Mark found particles and true ones by the rule of the LPT challenge.

    Without the truth all are found.
    """
    estimate = Cloud.of_kind(found.position_mm, FOUND, found.trajectory, found.velocity_mm_s)
    if not data.has_truth:
        return estimate
    grid, true = data.setup.grid, true_particles(data, frame)
    voxels = grid.to_voxels(estimate.position_mm), grid.to_voxels(true.position_mm)
    i, j = challenge_pairs(*voxels)
    duplicates = mark_duplicates(*voxels, i)
    estimate.kind[:] = np.where(duplicates, DUPLICATE, GHOST)
    return _join(estimate, true, i, j)


def find_peaks(found: Reconstruction, data: Dataset) -> FoundParticles:
    """Return a reconstruction's own particles, or the local maxima of its volume."""
    if found.particles_mm is not None:
        return FoundParticles(found.particles_mm)
    grid = data.setup.grid
    peaks = detect_peaks(found.volume)
    return FoundParticles(np.asarray(grid.low_mm) + peaks * np.asarray(grid.voxel_mm))


def classify_bubbles(found: Detections, data: Dataset, frame: int) -> Cloud:
    """Mark found bubbles and true ones by the rule of the task; see `match`."""
    kind = GHOST if data.has_truth else FOUND
    estimate = Cloud.of_kind(found.center_mm, kind, found.trajectory, shape_mm=_shapes(found))
    if not data.has_truth:
        return estimate
    true = true_bubbles(data, frame)
    pairs = match(found.center_mm, true.position_mm, data.bubbles(frame).radius_mm)
    return _join(estimate, true, *pairs)


def place_vectors(field: Velocity, data: Dataset, pair: tuple[int, int]) -> Cloud:
    """Place measured vectors and, where they are known, the true ones on a lattice."""
    nodes, vectors = field.positions_mm.reshape(-1, 3), field.velocity_mm_s.reshape(-1, 3)
    kind: U8 = np.where(field.valid.ravel(), FOUND, GHOST).astype(np.uint8)
    measured = Cloud.of_kind(nodes, kind, velocity_mm_s=vectors)
    if not data.has_truth:
        return measured
    exact = truth_at(data, pair, field).reshape(-1, 3)
    return Cloud.of_kind(nodes, TRUE, velocity_mm_s=exact) + measured


def place_target(found: Calibration, data: Dataset, frame: int) -> Cloud:
    """Place a target's true points, and the estimated ones if there are any."""
    true = target_points(data, frame) if data.has_truth and data.shows_target else None
    points = np.zeros((0, 3)) if found.points_mm is None else found.points_mm[frame]
    estimate = Cloud.of_kind(points, FOUND)
    return estimate if true is None else true + estimate


def _join(estimate: Cloud, true: Cloud, i: I64, j: I64) -> Cloud:
    """Join an estimate and the truth, whose rows i and j are pairs."""
    estimate.kind[i] = FOUND
    true.kind[:] = MISSED
    true.kind[j] = TRUE
    return true + estimate


def _shapes(bubbles: AnyBubbles) -> F64:
    """Compute the matrices (n, 3, 3) that turn a ball of radius 1 into each bubble."""
    return np.asarray(bubbles.turn.transpose(0, 2, 1) * bubbles.semi_axes_mm[:, None, :])
