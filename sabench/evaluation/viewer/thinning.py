"""Thinning of particles to as many as a page can show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.evaluation.viewer.clouds import Cloud
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.rng import stream

IN_FRAME, IN_ALL = 200_000, 400_000  # most objects
_PRIME, _SPAN = 2_654_435_761, 1 << 32  # Knuth's multiplicative hash


def shown_share(clouds: Sequence[Cloud]) -> float:
    """Compute the share of the objects of all frames that a page shows."""
    counts = [len(one) for one in clouds]
    return min(1.0, IN_FRAME / max([1, *counts]), IN_ALL / max(sum(counts), 1))


def thin(clouds: Sequence[Cloud], share: float) -> list[Cloud]:
    """Keep a share of the objects of all kinds, and trajectories intact."""
    if share >= 1.0:
        return list(clouds)
    return [one.select(_chosen(one, number, share)) for number, one in enumerate(clouds)]


def _chosen(cloud: Cloud, frame: int, share: float) -> Bool:
    """Choose objects by their trajectories; those without one at random."""
    draws = stream(0, "view", frame).random(len(cloud))
    return np.where(cloud.trajectory >= 0, _hash(cloud.trajectory), draws) < share


def _hash(numbers: I64) -> F64:
    """Scatter numbers (n,) over 0 to 1."""
    spread = (numbers % _SPAN).astype(np.uint64) * np.uint64(_PRIME) % np.uint64(_SPAN)
    return np.asarray(spread / _SPAN)
