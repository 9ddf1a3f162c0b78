"""Peaks of the feature potential over depth, and depths of outlines.

Source: J. Belden's thesis, section 5.4.3. There a group is a chain of peaks, each within half a
window and ten planes of another one. Among many bubbles such chains run from one to the next, and
their mean depth is that of none; here a group reaches at most ten planes from its strongest peak,
and as far sideways as the largest bubble.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from sabench.algorithms.bubbles.feature_potential import WINDOW
from sabench.utils.arrays import F32, F64, I64, Bool

STEP = WINDOW // 2  # voxels between windows that overlap by half
PLANES = 10  # from a group's strongest peak to the others
_NEAR = 5  # planes on both sides of the darkest one that make a depth
_OVERLAP = 0.8  # of the larger one's semi-axis: bubbles whose centres are nearer are one
_LARGER = 1.5  # times: the smaller one of two is a part of the other


@dataclass(frozen=True)
class FeaturePeaks:
    """Peaks of every window's potential over depth, the strongest first.

    Attributes
    ----------
    position : (n, 3) plane, window row, window column.
    weight : (n,) the potential.
    """

    position: I64
    weight: F64

    @classmethod
    def find(cls, potential: F32, least: float) -> FeaturePeaks:
        """Find the peaks along depth of a potential (z, window rows, window columns).

        A peak is larger than one plane before and after, and than `least`.
        """
        around = np.pad(potential, ((1, 1), (0, 0), (0, 0)))
        position = np.argwhere(
            (potential > least) & (potential >= around[:-2]) & (potential > around[2:])
        )
        weight = potential[tuple(position.T)].astype(np.float64)
        order = np.argsort(-weight, kind="stable")
        return cls(position[order], weight[order])

    def group(self, first: int, free: Bool, reach: int) -> I64:
        """Collect the free peaks that neighbouring windows connect with one.

        Returns their indices; none is farther from it than `reach` windows and `PLANES`.
        """
        apart = self.position - self.position[first]
        near = np.flatnonzero(
            free & (np.abs(apart[:, 0]) <= PLANES) & (np.abs(apart[:, 1:]).max(axis=1) <= reach)
        )
        row, column = (apart[near, 1:] + reach).T
        taken = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.bool_)
        taken[row, column] = True
        parts, _ = label(taken, np.ones((3, 3)))
        return np.asarray(near[parts[row, column] == parts[reach, reach]])

    def plane(self, group: I64) -> int:
        """Compute the plane of a group: the mean over its peaks, weighted with them."""
        return round(float(np.average(self.position[group, 0], weights=self.weight[group])))

    def within(self, bubble: F64, planes: int) -> Bool:
        """Mark the peaks within some planes of a bubble (7,) and in its circle."""
        y, x = (self.position[:, axis] * STEP + (WINDOW - 1) / 2.0 for axis in (1, 2))
        return np.asarray(
            (np.hypot(x - bubble[0], y - bubble[1]) <= bubble[2] + WINDOW / 2.0)
            & (np.abs(self.position[:, 0] - bubble[6]) <= planes)
        )


def find_depth(volume: F32, outline: F64, plane: int) -> float:
    """Find the plane, to a fraction, in which the rim of an outline is darkest.

    The rim is the part inside the outline within a voxel of it. The plane is the mean of those
    around the darkest one, weighted with the square of their mean darkness.

    Parameters
    ----------
    volume : darkness (z, y, x).
    outline : column, row, semi-axes, angle in voxels.
    plane : from which at most `PLANES` are gone.
    """
    rows, columns, inside = _inside(volume.shape[1:], outline)
    first = max(plane - PLANES, 0)
    stack = volume[first : plane + PLANES + 1, rows, columns][:, inside]
    if not stack.size:
        return float(plane)
    dark = stack.mean(axis=1, dtype=np.float64)
    index = np.arange(len(dark))
    weight = np.where(np.abs(index - dark.argmax()) <= _NEAR, dark**2, 0.0)
    return first + float(np.average(index, weights=weight)) if weight.any() else float(plane)


def _inside(shape: tuple[int, ...], outline: F64) -> tuple[slice, slice, Bool]:
    """Cut out a box and mark its voxels inside an outline grown by a voxel."""
    x, y, a, b, angle = outline[:5]
    rows = slice(max(int(y - a) - 1, 0), max(min(int(y + a) + 3, shape[0]), 0))
    columns = slice(max(int(x - a) - 1, 0), max(min(int(x + a) + 3, shape[1]), 0))
    down, right = np.mgrid[rows, columns]
    u = (right - x) * np.cos(angle) + (down - y) * np.sin(angle)
    w = (down - y) * np.cos(angle) - (right - x) * np.sin(angle)
    return rows, columns, np.asarray((u / (a + 1.0)) ** 2 + (w / (b + 1.0)) ** 2 <= 1.0)


def drop_duplicates(bubbles: F64, depth: float) -> F64:
    """Merge bubbles (n, 7) at one position, and sort them by size, the largest first.

    A much smaller one is left out; two similar ones are merged to their mean, weighted with the
    parts of their outlines that have edges, with the angle of the first.

    Parameters
    ----------
    bubbles : column, row, semi-axes, angle, part of the outline that has edges, plane.
    depth : distance of planes in voxels.
    """
    kept: list[F64] = []
    for one in bubbles[np.argsort(-bubbles[:, 2], kind="stable")]:
        for other in kept:
            if np.linalg.norm((one - other)[[0, 1, 6]] * [1.0, 1.0, depth]) > _OVERLAP * other[2]:
                continue
            if _LARGER * one[2] >= other[2]:
                share = one[5] / max(one[5] + other[5], 1e-9)
                other[[0, 1, 2, 3, 6]] += share * (one - other)[[0, 1, 2, 3, 6]]
                other[5] = max(one[5], other[5])
            break
        else:
            kept.append(one.copy())
    return np.array(kept, dtype=np.float64).reshape(-1, 7)
