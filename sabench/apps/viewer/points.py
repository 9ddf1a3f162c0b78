"""True and found points to show of each frame, classified as scores do.

Where there are too many, they are thinned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sabench import tasks
from sabench.api import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.geometry.camera_model import CameraModel
from sabench.metrics.bubble_detection import AnyBubbles, match_bubbles
from sabench.metrics.particle_detection import classify, detect_peaks
from sabench.plotting.kinds import FOUND, GHOST, KINDS, MISSED, TRUE
from sabench.tasks.velocimetry import truth_at
from sabench.utils.arrays import F32, F64, I64, U8, Bool
from sabench.utils.rng import stream

_OF_TRUTH = (TRUE, MISSED)


@dataclass(frozen=True)
class ObjectCloud:
    """Particles or bubbles at one instant.

    Attributes
    ----------
    position_mm : (n, 3).
    kind : (n,) indices into `KINDS`.
    trajectory : (n,) numbers, different within the true ones and within the estimated ones; -1 for
        none.
    velocity_mm_s : (n, 3), NaN where it is not known.
    shape_mm : (n, 3, 3) matrices that turn a ball of radius 1 into each bubble; None for particles.
    """

    position_mm: F64
    kind: U8
    trajectory: I64
    velocity_mm_s: F64
    shape_mm: F64 | None = None

    def __len__(self) -> int:
        """Return the number of objects."""
        return len(self.kind)

    @classmethod
    def of_kind(
        cls,
        position_mm: F64,
        kind: int | U8,
        trajectory: I64 | None = None,
        velocity_mm_s: F64 | None = None,
        shape_mm: F64 | None = None,
    ) -> ObjectCloud:
        """Make a cloud; what is not known is None."""
        count = len(position_mm)
        kinds = np.broadcast_to(np.asarray(kind, dtype=np.uint8), (count,)).copy()
        numbers = np.full(count, -1) if trajectory is None else trajectory
        velocity = np.full((count, 3), np.nan) if velocity_mm_s is None else velocity_mm_s
        return cls(np.asarray(position_mm, np.float64), kinds, numbers, velocity, shape_mm)

    def __add__(self, other: ObjectCloud) -> ObjectCloud:
        """Join two clouds of the same objects."""
        shapes = None
        if self.shape_mm is not None and other.shape_mm is not None:
            shapes = np.concatenate([self.shape_mm, other.shape_mm])
        return ObjectCloud(
            np.concatenate([self.position_mm, other.position_mm]),
            np.concatenate([self.kind, other.kind]),
            np.concatenate([self.trajectory, other.trajectory]),
            np.concatenate([self.velocity_mm_s, other.velocity_mm_s]),
            shapes,
        )

    def select(self, chosen: Bool | I64) -> ObjectCloud:
        """Select some of the objects."""
        return ObjectCloud(
            self.position_mm[chosen],
            self.kind[chosen],
            self.trajectory[chosen],
            self.velocity_mm_s[chosen],
            None if self.shape_mm is None else self.shape_mm[chosen],
        )

    def counts(self) -> list[int]:
        """Count the objects of each kind."""
        return [int(count) for count in np.bincount(self.kind, minlength=len(KINDS))]


def link_to_earlier(cloud: ObjectCloud, earlier: ObjectCloud | None) -> I64:
    """Find the row (n,) of each object in the frame before; -1 where it has none."""
    rows = np.full(len(cloud), -1, dtype=np.int64)
    if earlier is None:
        return rows
    for true in (True, False):
        later, other = (
            np.flatnonzero(np.isin(part.kind, _OF_TRUTH, invert=not true) & (part.trajectory >= 0))
            for part in (cloud, earlier)
        )
        _, i, j = np.intersect1d(
            cloud.trajectory[later], earlier.trajectory[other], return_indices=True
        )
        rows[later[i]] = other[j]
    return rows


def with_velocities(clouds: Sequence[ObjectCloud], times_s: Sequence[float]) -> list[ObjectCloud]:
    """Fill in unknown velocities from the positions in the frame before, or after."""
    velocities = [cloud.velocity_mm_s.copy() for cloud in clouds]
    for number in range(1, len(clouds)):
        rows = link_to_earlier(clouds[number], clouds[number - 1])
        both = np.flatnonzero(rows >= 0)
        step = clouds[number].position_mm[both] - clouds[number - 1].position_mm[rows[both]]
        mean = step / (times_s[number] - times_s[number - 1])
        for velocity, which in ((velocities[number], both), (velocities[number - 1], rows[both])):
            unknown = np.isnan(velocity[which]).any(axis=1)
            velocity[which[unknown]] = mean[unknown]
    return [replace(cloud, velocity_mm_s=v) for cloud, v in zip(clouds, velocities, strict=True)]


def true_particles(data: Dataset, frame: int) -> ObjectCloud:
    """Read the true particles of a frame."""
    true = data.particles(frame)
    return ObjectCloud.of_kind(true.position_mm, TRUE, true.id, true.velocity_mm_s)


def true_bubbles(data: Dataset, frame: int) -> ObjectCloud:
    """Read the true bubbles of a frame."""
    true = data.bubbles(frame)
    return ObjectCloud.of_kind(true.center_mm, TRUE, true.id, true.velocity_mm_s, _shapes(true))


def read_target_points(data: Dataset, frame: int) -> ObjectCloud:
    """Read the true points of a calibration target."""
    points = data.placed().points_mm[frame]
    return ObjectCloud.of_kind(points, TRUE)


def classify_particles(found: FoundParticles, data: Dataset, frame: int) -> ObjectCloud:
    """Mark found particles and true ones by the rule of the LPT challenge.

    Without truth, all particles are of the kind FOUND.
    """
    estimate = ObjectCloud.of_kind(found.position_mm, FOUND, found.trajectory, found.velocity_mm_s)
    if not data.has_truth:
        return estimate
    grid, true = data.setup.grid, true_particles(data, frame)
    voxels = grid.to_voxels(estimate.position_mm), grid.to_voxels(true.position_mm)
    estimate.kind[:], i, j = classify(*voxels)
    return _join(estimate, true, i, j)


def _find_peaks(found: Reconstruction, data: Dataset) -> FoundParticles:
    """Return a reconstruction's own particles, or the local maxima of its volume."""
    if found.particles_mm is not None:
        return FoundParticles(found.particles_mm)
    grid = data.setup.grid
    peaks = detect_peaks(found.volume)
    return FoundParticles(np.asarray(grid.low_mm) + peaks * np.asarray(grid.voxel_mm))


def classify_bubbles(found: Detections, data: Dataset, frame: int) -> ObjectCloud:
    """Mark found bubbles and true ones by the rule of the task; see `match`."""
    kind = GHOST if data.has_truth else FOUND
    estimate = ObjectCloud.of_kind(found.center_mm, kind, found.trajectory, shape_mm=_shapes(found))
    if not data.has_truth:
        return estimate
    true = true_bubbles(data, frame)
    pairs = match_bubbles(found.center_mm, true.position_mm, data.bubbles(frame).radius_mm)
    return _join(estimate, true, *pairs)


def place_vectors(field: Velocity, data: Dataset, pair: tuple[int, int]) -> ObjectCloud:
    """Place measured vectors and, where they are known, the true ones on a lattice."""
    nodes, vectors = field.positions_mm.reshape(-1, 3), field.velocity_mm_s.reshape(-1, 3)
    kind: U8 = np.where(field.valid.ravel(), FOUND, GHOST).astype(np.uint8)
    measured = ObjectCloud.of_kind(nodes, kind, velocity_mm_s=vectors)
    if not data.has_truth:
        return measured
    exact = truth_at(data, pair, field).reshape(-1, 3)
    return ObjectCloud.of_kind(nodes, TRUE, velocity_mm_s=exact) + measured


def place_target(found: Calibration, data: Dataset, frame: int) -> ObjectCloud:
    """Place a target's true points, and the estimated ones if there are any."""
    true = read_target_points(data, frame) if data.has_truth and data.shows_target else None
    points = np.zeros((0, 3)) if found.points_mm is None else found.points_mm[frame]
    estimate = ObjectCloud.of_kind(points, FOUND)
    return estimate if true is None else true + estimate


def _join(estimate: ObjectCloud, true: ObjectCloud, i: I64, j: I64) -> ObjectCloud:
    """Join an estimate and the truth; rows i and j are matched."""
    estimate.kind[i] = FOUND
    true.kind[:] = MISSED
    true.kind[j] = TRUE
    return true + estimate


def _shapes(bubbles: AnyBubbles) -> F64:
    """Compute the matrices (n, 3, 3) that turn a ball of radius 1 into each bubble."""
    return np.asarray(bubbles.turn.transpose(0, 2, 1) * bubbles.semi_axes_mm[:, None, :])


MOST = 400_000  # objects of all frames


def shown_share(clouds: Sequence[ObjectCloud]) -> float:
    """Compute the share of the objects of all frames that a page shows."""
    return min(1.0, MOST / max(sum(map(len, clouds)), 1))


def thin(clouds: Sequence[ObjectCloud], share: float) -> list[ObjectCloud]:
    """Keep a share of the objects of all kinds, and trajectories intact."""
    if share >= 1.0:
        return list(clouds)
    return [cloud.select(_chosen(cloud, number, share)) for number, cloud in enumerate(clouds)]


def _chosen(cloud: ObjectCloud, frame: int, share: float) -> Bool:
    """Choose every so many-th trajectory; objects without one at random."""
    draws = stream(0, "view", frame).random(len(cloud))
    return np.where(cloud.trajectory >= 0, cloud.trajectory * share % 1.0, draws) < share


class Estimates:
    """Reader of a result's estimates.

    Attributes
    ----------
    cameras : that a solver has calibrated; none for other results.
    volume : reconstruction (z, y, x) of the first frame, when it has been read; else None.
    peaks : whether particles are local maxima of volumes.

    Raises
    ------
    InputError
        A result of a task that the data set does not serve.
    """

    def __init__(self, data: Dataset, result: Result) -> None:
        self._data, self._result, self._task = data, result, tasks.of(result.task)
        if data.has_truth:
            tasks.check_task(result.task, data, result.path)
        self._pairs = dict(data.setup.pairs())
        self._calibration: Calibration | None = None
        self.volume: F32 | None = None
        self.peaks = False
        if self._task.estimate is Calibration:
            self._calibration = self._read(0)

    @property
    def cameras(self) -> tuple[CameraModel, ...]:
        """Calibrated cameras."""
        return () if self._calibration is None else self._calibration.cameras

    def particles(self, frame: int) -> ObjectCloud | None:
        """Read a frame's particles, vectors or points; None where there are none."""
        data, kind = self._data, self._task.estimate
        if kind is FoundParticles:
            return classify_particles(self._read(frame), data, frame)
        if kind is Reconstruction:
            return self._of_volume(frame)
        if kind is Velocity and frame in self._pairs:
            return place_vectors(self._read(frame), data, (frame, self._pairs[frame]))
        if self._calibration is not None:
            return place_target(self._calibration, data, frame)
        return None

    def bubbles(self, frame: int) -> ObjectCloud | None:
        """Read a frame's bubbles; None where there are none."""
        if self._task.estimate is not Detections:
            return None
        return classify_bubbles(self._read(frame), self._data, frame)

    def _of_volume(self, frame: int) -> ObjectCloud | None:
        """Read a volume's particles; a volume without particles shows a code."""
        estimate: Reconstruction = self._read(frame)
        if frame == 0:
            self.volume = estimate.volume
        if self._result.task != "reconstruction":
            return None
        self.peaks = estimate.particles_mm is None
        peaks = _find_peaks(estimate, self._data)
        return classify_particles(peaks, self._data, frame)

    def _read(self, frame: int) -> Any:
        return self._task.read(self._data, self._result, frame)
