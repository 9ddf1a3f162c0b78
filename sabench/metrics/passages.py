"""Passages of tracked objects through a plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.utils.arrays import F64, I64


def count_passages(
    along_mm: Sequence[F64], trajectory: Sequence[I64], plane_mm: float
) -> list[int]:
    """Count the trajectories that have passed a plane until each frame.

    A trajectory passes once: when it is first found beyond the plane, after a frame in which it was
    found before it.

    Parameters
    ----------
    along_mm : coordinates (n,) of each frame's objects along the plane's normal.
    trajectory : numbers (n,) of their trajectories.

    Returns
    -------
    One count for each frame, that of the first is 0.
    """
    before, passed, counts = set[int](), set[int](), list[int]()
    for along, number in zip(along_mm, trajectory, strict=True):
        beyond = np.asarray(along) > plane_mm
        passed |= before & set(number[beyond].tolist())
        before |= set(number[~beyond].tolist())
        counts.append(len(passed))
    return counts
