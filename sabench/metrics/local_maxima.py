"""Local maxima of a volume among 26 neighbours, with sub-voxel positions."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from sabench.utils.arrays import F32, F64, I64, Bool

_AROUND = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


def fitted_maxima(volume: F32, floor: float) -> F64:
    """Locate the maxima of E >= floor as fractional voxel indices (n, 3) of x, y, z.

    They are in the order of their first voxels.
    A voxel higher than its 26 neighbours is a maximum; so is a plateau, connected voxels of one
    value, that no neighbour exceeds, at the mean of its voxels.
    """
    highest_around = maximum_filter(volume, 3, mode="nearest")
    highest = np.flatnonzero((volume >= floor) & (volume == highest_around))
    tied = np.zeros(len(highest), dtype=np.bool_)
    for step in _AROUND:
        _, equal = _equals(volume, highest, step)
        tied[equal] = True
    first, place = _plateaus(volume, highest[tied])
    single = highest[~tied]
    order = np.argsort(np.concatenate([single, first]))
    return np.concatenate([_fit(volume, single), place])[order]


def _equals(volume: F32, voxels: I64, step: tuple[int, ...]) -> tuple[I64, I64]:
    """Find neighbours one step away that have the same value as their voxels.

    Returns the neighbours' flat indices, and the rows of the voxels.
    """
    places = np.unravel_index(voxels, volume.shape)
    inside = np.ones(len(voxels), dtype=np.bool_)
    for place, shift, size in zip(places, step, volume.shape, strict=True):
        inside &= (place + shift >= 0) & (place + shift < size)
    rows = np.flatnonzero(inside)
    away = (step[0] * volume.shape[1] + step[1]) * volume.shape[2] + step[2]
    near, flat = voxels[rows] + away, volume.reshape(-1)
    equal = flat[near] == flat[voxels[rows]]
    return near[equal], rows[equal]


def _plateaus(volume: F32, tied: I64) -> tuple[I64, F64]:
    """Join voxels that no neighbour exceeds and some equal.

    Returns the first voxel of each plateau that is a maximum, and its mean (n, 3) of x, y, z.
    """
    if not len(tied):
        return tied, np.zeros((0, 3))
    lower, pairs = np.zeros(len(tied), dtype=np.bool_), [np.zeros((2, 0), dtype=np.int64)]
    for step in _AROUND:
        near, rows = _equals(volume, tied, step)
        place = np.minimum(np.searchsorted(tied, near), len(tied) - 1)
        among: Bool = tied[place] == near
        lower[rows[~among]] = True  # a voxel of the same value has a higher neighbour
        pairs.append(np.stack([rows[among], place[among]]))
    one, other = np.concatenate(pairs, axis=1)
    links = csr_array((np.ones(len(one), dtype=np.bool_), (one, other)), shape=(len(tied),) * 2)
    count, label = connected_components(links, directed=False)
    places = np.stack(np.unravel_index(tied, volume.shape)[::-1], axis=1).reshape(-1, 3)
    size = np.bincount(label, minlength=count)
    total = [np.bincount(label, weights=axis, minlength=count) for axis in places.T]
    first = np.zeros(count, dtype=np.int64)
    first[label[::-1]] = tied[::-1]
    highest = np.bincount(label[lower], minlength=count) == 0
    return first[highest], (np.stack(total, axis=1) / size[:, None])[highest]


def _fit(volume: F32, voxels: I64) -> F64:
    """Fit Gaussians through voxels and their neighbours: x, y, z (n, 3)."""
    places = np.unravel_index(voxels, volume.shape)
    position = np.stack(places[::-1], axis=1).astype(np.float64).reshape(-1, 3)
    flat, step = volume.reshape(-1), 1
    for axis, size in enumerate(volume.shape[::-1]):
        rows = np.flatnonzero((position[:, axis] > 0) & (position[:, axis] < size - 1))
        at = voxels[rows]
        values = zip(*(flat[at + k].tolist() for k in (-step, 0, step)), strict=True)
        position[rows, axis] += [three_point(*three) for three in values]
        step *= size
    return position


def three_point(before: float, value: float, after: float) -> float:
    """Compute the offset of the vertex of a Gaussian through three values.

    The middle value is the highest; the offset lies between -1/2 and 1/2. Where a neighbour is 0
    and has no logarithm, it is that of the centroid of the three values.

    Source: Willert and Gharib, Exp. Fluids 10 (1991) 181-193.
    """
    if before <= 0.0 or after <= 0.0:
        return (after - before) / (before + value + after)
    a, b, c = math.log(before), math.log(value), math.log(after)
    return 0.5 * (a - c) / (a - 2.0 * b + c)
