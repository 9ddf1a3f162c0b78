"""Particles, bubbles and vectors of one frame, and what became of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.utils.arrays import F64, I64, U8, Bool

# the page draws them in this order, the errors last and so above the others
KINDS = ("true", "found", "missed", "ghost", "duplicate")
TRUE, FOUND, MISSED, GHOST, DUPLICATE = range(len(KINDS))
_OF_TRUTH = (TRUE, MISSED)


@dataclass(frozen=True)
class Cloud:
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
    ) -> Cloud:
        """Make a cloud; what is not known is None."""
        count = len(position_mm)
        kinds = np.broadcast_to(np.asarray(kind, dtype=np.uint8), (count,)).copy()
        numbers = np.full(count, -1) if trajectory is None else trajectory
        velocity = np.full((count, 3), np.nan) if velocity_mm_s is None else velocity_mm_s
        return cls(np.asarray(position_mm, np.float64), kinds, numbers, velocity, shape_mm)

    def __add__(self, other: Cloud) -> Cloud:
        """Join two clouds of the same objects."""
        shapes = None
        if self.shape_mm is not None and other.shape_mm is not None:
            shapes = np.concatenate([self.shape_mm, other.shape_mm])
        return Cloud(
            np.concatenate([self.position_mm, other.position_mm]),
            np.concatenate([self.kind, other.kind]),
            np.concatenate([self.trajectory, other.trajectory]),
            np.concatenate([self.velocity_mm_s, other.velocity_mm_s]),
            shapes,
        )

    def select(self, chosen: Bool | I64) -> Cloud:
        """Select some of the objects."""
        return Cloud(
            self.position_mm[chosen],
            self.kind[chosen],
            self.trajectory[chosen],
            self.velocity_mm_s[chosen],
            None if self.shape_mm is None else self.shape_mm[chosen],
        )

    def counts(self) -> list[int]:
        """Count the objects of each kind."""
        return [int(count) for count in np.bincount(self.kind, minlength=len(KINDS))]


def link_to_earlier(cloud: Cloud, earlier: Cloud | None) -> I64:
    """Find the row (n,) of each object in the frame before; -1 where it has none."""
    rows = np.full(len(cloud), -1, dtype=np.int64)
    if earlier is None:
        return rows
    for true in (True, False):
        own, other = (
            np.flatnonzero((np.isin(one.kind, _OF_TRUTH, invert=not true)) & (one.trajectory >= 0))
            for one in (cloud, earlier)
        )
        _, i, j = np.intersect1d(
            cloud.trajectory[own], earlier.trajectory[other], return_indices=True
        )
        rows[own[i]] = other[j]
    return rows


def with_velocities(clouds: Sequence[Cloud], times_s: Sequence[float]) -> list[Cloud]:
    """Fill in unknown velocities from the positions in the frame before, or after."""
    velocities = [one.velocity_mm_s.copy() for one in clouds]
    for number in range(1, len(clouds)):
        rows = link_to_earlier(clouds[number], clouds[number - 1])
        own = np.flatnonzero(rows >= 0)
        step = clouds[number].position_mm[own] - clouds[number - 1].position_mm[rows[own]]
        mean = step / (times_s[number] - times_s[number - 1])
        for velocity, which in ((velocities[number], own), (velocities[number - 1], rows[own])):
            unknown = np.isnan(velocity[which]).any(axis=1)
            velocity[which[unknown]] = mean[unknown]
    return [replace(one, velocity_mm_s=v) for one, v in zip(clouds, velocities, strict=True)]
