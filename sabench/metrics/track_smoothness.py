"""Smoothness of trajectories, which tells errors of positions without truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.utils.arrays import F64, I64

_FACTORS = {3: np.array([1.0, -2.0, 1.0]), 4: np.array([1.0, -3.0, 3.0, -1.0])}


def differences(numbers: Sequence[I64], positions: Sequence[F64], order: int) -> F64:
    """Compute differences (k, 3) of positions of trajectories over frames in a row.

    Parameters
    ----------
    numbers, positions : trajectories (n,) and positions (n, 3) in each frame.
    order : 2 or 3, of differences over 3 or 4 frames.
    """
    factors = _FACTORS[order + 1]
    found = [np.zeros((0, 3))]
    for first in range(len(numbers) - order):
        window = range(first, first + order + 1)
        common = numbers[first]
        for frame in window:
            common = np.intersect1d(common, numbers[frame])
        total = np.zeros((len(common), 3))
        for factor, frame in zip(factors, window, strict=True):
            sorter = np.argsort(numbers[frame])
            rows = sorter[np.searchsorted(numbers[frame], common, sorter=sorter)]
            total += factor * positions[frame][rows]
        found.append(total)
    return np.concatenate(found)


def jitter_mm(numbers: Sequence[I64], positions: Sequence[F64]) -> float:
    """Estimate the standard deviation of positions along each axis from their jitter.

    Third differences of four frames in a row vanish for smooth trajectories, and errors of
    positions give them 20 times their variance; with three frames it is second differences, and 6
    times. The median over all distances resists wrong links. NaN without three frames in a row.
    """
    order = 3 if len(numbers) > 3 else 2
    jumps = differences(numbers, positions, order)
    if not len(jumps):
        return float("nan")
    # median of the length of normal vectors in space, over the deviation along an axis
    scale = 1.5382 * np.sqrt((_FACTORS[order + 1] ** 2).sum())
    return float(np.median(np.linalg.norm(jumps, axis=1)) / scale)


def share_followed(numbers: Sequence[I64], frames: int) -> float:
    """Compute the share of found particles in trajectories of enough frames.

    NaN without any.
    """
    every = np.concatenate([np.zeros(0, dtype=np.int64), *numbers])
    if not len(every):
        return float("nan")
    counts = np.unique(every, return_counts=True)[1]
    return float(counts[counts >= frames].sum() / len(every))
