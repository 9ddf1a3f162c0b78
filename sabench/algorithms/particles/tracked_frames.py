"""Frames whose particles are tracked, and how these move.

That is told by their positions in the frames around.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.particles.kalman_tracks import ANY_SPEED, velocity_near
from sabench.algorithms.particles.search_state import joined, no_particles
from sabench.algorithms.particles.track_motion import most_probable_motion
from sabench.api import FoundParticles
from sabench.utils.arrays import F64, I64, Bool


@dataclass
class TrackedFrame:
    """Particles of a frame, their trajectories (n,), and whether they were seen."""

    time: float
    found: FoundParticles
    number: I64
    seen: Bool

    @property
    def position(self) -> F64:
        """Positions (n, 3), mm."""
        return self.found.position_mm

    @property
    def variance(self) -> F64:
        """Variances (n, 3) of positions, mm2."""
        return np.asarray(self.found.covariance_mm2)[:, [0, 1, 2], [0, 1, 2]]

    def add(self, more: FoundParticles, number: I64) -> None:
        """Add particles that were not seen."""
        self.found = joined(self.found, more)
        self.number = np.concatenate([self.number, number])
        self.seen = np.concatenate([self.seen, np.zeros(len(number), dtype=np.bool_)])

    def drop(self, ghosts: I64) -> None:
        """Drop some trajectories."""
        kept = ~np.isin(self.number, ghosts)
        self.found, self.number = self.found.rows(kept), self.number[kept]
        self.seen = self.seen[kept]


def no_frame(time: float, cameras: int) -> TrackedFrame:
    """Return a frame without particles."""
    return TrackedFrame(
        time, no_particles(cameras), np.zeros(0, dtype=np.int64), np.zeros(0, np.bool_)
    )


def with_motion(
    frames: Sequence[TrackedFrame], frame: TrackedFrame, motion: tuple[float, float] | None
) -> FoundParticles:
    """Add velocities and accelerations to a frame, from it and those around it.

    Particles that were not seen get their positions, too.
    """
    found = replace(frame.found, trajectory=frame.number)
    if motion is None or not len(frame.number):
        return found
    times = np.array([one.time - frame.time for one in frames])
    positions = _positions(frames, frame.number)
    moving = np.isfinite(positions[0][:, :, 0]).sum(axis=1) > 1
    still = np.zeros_like(frame.position), np.full_like(frame.position, ANY_SPEED**2)
    state, _ = most_probable_motion(times, *positions, *still, *motion)
    expected = velocity_near(frame.position, frame.position[moving], state[moving, 1])
    state, covariance = most_probable_motion(times, *positions, *expected, *motion)
    seen = frame.seen[:, None]
    place = np.where(seen, frame.position, state[:, 0])
    error = np.where(seen[:, None], np.asarray(found.covariance_mm2), _diagonal(covariance, 0))
    return replace(
        found,
        position_mm=place,
        covariance_mm2=error,
        velocity_mm_s=state[:, 1],
        velocity_covariance=_diagonal(covariance, 1),
        acceleration_mm_s2=state[:, 2],
        acceleration_covariance=_diagonal(covariance, 2),
    )


def _positions(frames: Sequence[TrackedFrame], number: I64) -> tuple[F64, F64]:
    """Collect places of trajectories in some frames, and variances: (n, frame, 3).

    NaN where they were not seen.
    """
    position, variance = (np.full((len(number), len(frames), 3), np.nan) for _ in range(2))
    for slot, one in enumerate(frames):
        _, i, j = np.intersect1d(number, one.number[one.seen], return_indices=True)
        position[i, slot] = one.position[one.seen][j]
        variance[i, slot] = one.variance[one.seen][j]
    return position, variance


def _diagonal(covariance: F64, order: int) -> F64:
    """Make covariances (n, 3, 3) over axes of one order of the motion."""
    return np.asarray(covariance[:, :, order, order, None] * np.eye(3))
