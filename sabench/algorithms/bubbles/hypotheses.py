"""Possible positions of bubbles in space.

Outlines of one view are followed along their lines of sight, and searched for in all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.bubbles.hough_circles import Votes, peaks
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import numba

_PLANE_MM = 0.25  # between positions along a line of sight, at most
_AGREE = 0.75  # of the cameras that see a position count: those with the most votes
_SPREAD = 0.8  # px
# of the radius with the most votes: a blurred edge is steepest outside the rim of a small bubble
_INWARD = 0.93
_PER_LINE = 3  # positions along each line that are kept
_BEYOND = 0.02  # of the volume's depth: how far outside it lines are followed


@dataclass(frozen=True)
class Hypotheses:
    """Possible bubbles.

    Centres (n, 3), long semi-axes (n,), mean votes (n,), short over long axis (n,), the best first.
    """

    center_mm: F64
    radius_mm: F64
    vote: F64
    aspect: F64


def find_hypotheses(
    cameras: Sequence[Camera], votes: Sequence[Votes], grid: Grid, least_2d: float, least_3d: float
) -> Hypotheses:
    """Find balls whose outlines are voted for in most views.

    Parameters
    ----------
    least_2d, least_3d : votes in one view that make it worth to look in the others; mean votes that
        make a hypothesis.
    """
    maps = np.empty((len(votes), *votes[0].maps.shape), dtype=np.float32)
    for out, one in zip(maps, votes, strict=True):
        _spread(one.maps, out)
    made = [
        _along_lines(number, cameras, votes, maps, grid, least_2d, least_3d)
        for number in range(len(cameras))
    ]
    center, radius, vote = (np.concatenate([part[k] for part in made]) for k in range(3))
    return drop_duplicates(Hypotheses(center, radius, vote, np.full(len(vote), votes[0].aspect)))


def join_hypotheses(parts: Sequence[Hypotheses]) -> Hypotheses:
    """Join hypotheses of several aspects."""
    center, radius, vote, aspect = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("center_mm", "radius_mm", "vote", "aspect")
    )
    return drop_duplicates(Hypotheses(center, radius, vote, aspect))


def _spread(maps: F32, out: F32) -> None:
    """Smooth votes.

    Smoothing is needed since positions do not project to the exact pixels in other views. A maximum
    over neighbours would be as good at many depths.
    """
    import cv2

    for one, smooth in zip(maps, out, strict=True):
        cv2.GaussianBlur(one, (0, 0), _SPREAD, dst=smooth)


def _along_lines(
    number: int,
    cameras: Sequence[Camera],
    votes: Sequence[Votes],
    maps: F32,
    grid: Grid,
    least_2d: float,
    least_3d: float,
) -> tuple[F64, F64, F64]:
    """Find the best positions of one view's outlines."""
    seen = peaks(votes[number], least_2d)
    rays = cameras[number].back_project(seen[:, :2])
    seen, starts, ways = seen[rays.valid], rays.origins_mm[rays.valid], rays.directions[rays.valid]
    if not len(seen):
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    z = grid.axes_mm[2]
    margin = _BEYOND * (z[-1] - z[0]) + 1.0
    depths = np.arange(z[0] - margin, z[-1] + margin, min(_PLANE_MM, grid.voxel_mm[2] * 1.25))
    positions = (
        starts[:, None]
        + ways[:, None] * ((depths[None] - starts[:, None, 2]) / ways[:, None, 2])[..., None]
    )
    own = px_per_mm(cameras[number], positions.reshape(-1, 3)).reshape(positions.shape[:2])
    radius = _INWARD * seen[:, 2:3] / own
    total = np.full((len(cameras), *positions.shape[:2]), np.nan, dtype=np.float32)
    first, step = (
        float(np.log(votes[0].radii_px[0])),
        float(np.log(votes[0].radii_px[1] / votes[0].radii_px[0])),
    )
    for other, camera in enumerate(cameras):
        pixels, valid = camera.project(positions.reshape(-1, 3))
        good = valid & camera.contains(pixels)
        size = radius.ravel() / _INWARD * px_per_mm(camera, positions.reshape(-1, 3))
        _sample(
            maps[other],
            votes[other].map_pixels(pixels),
            good,
            size,
            first,
            step,
            total[other].reshape(-1),
        )
    low, high = np.asarray(grid.low_mm), np.array([axis[-1] for axis in grid.axes_mm])
    inside = ((positions[..., :2] >= low[:2] - 1.0) & (positions[..., :2] <= high[:2] + 1.0)).all(
        axis=-1
    )
    score = np.where(inside, _average_agreeing(total), 0.0)
    peak = (
        (score >= least_3d)
        & (score >= np.roll(score, 1, axis=1))
        & (score > np.roll(score, -1, axis=1))
    )
    ranked = np.sort(np.where(peak, score, 0.0), axis=1)[:, -_PER_LINE]
    i, j = np.nonzero(peak & (score >= ranked[:, None]))
    return positions[i, j], radius[i, j], score[i, j].astype(np.float64)


def px_per_mm(camera: Camera, points_mm: F64) -> F64:
    """Compute pixels per mm across the line of sight at points (n, 3).

    The length of the light path gives it, accurately enough to choose a radius.
    """
    step = 0.5
    across = step * np.array([1.0, 0.0, 0.0])
    ends = [camera.project(points_mm + sign * across)[0] for sign in (-1.0, 1.0)]
    return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=1) / (2.0 * step))


def _average_agreeing(total: F32) -> F32:
    """Average the votes of the cameras that agree most; two at least."""
    seen = np.isfinite(total)
    count = seen.sum(axis=0)
    used = np.maximum(2, np.round(_AGREE * count)).astype(np.int64)
    ranked = -np.sort(-np.where(seen, total, -1.0), axis=0)
    sums = np.cumsum(ranked, axis=0)
    mean = np.take_along_axis(sums, np.minimum(used, len(total))[None] - 1, axis=0)[0] / used
    return np.where(count >= 2, mean, 0.0).astype(np.float32)


@numba.njit(cache=True, parallel=True, error_model="numpy")
def _sample(
    maps: Any, pixels: Any, good: Any, size: Any, first: float, step: float, out: Any
) -> None:
    """Sample votes at pixels and radii.

    Sampling is bilinear over the radius and takes the nearest pixel in the image.
    """
    count, rows, columns = maps.shape
    for n in numba.prange(len(out)):
        if not good[n]:
            continue
        column, row = int(np.floor(pixels[n, 0] + 0.5)), int(np.floor(pixels[n, 1] + 0.5))
        if column < 0 or row < 0 or column >= columns or row >= rows:
            continue
        position = min(max((np.log(size[n]) - first) / step, 0.0), count - 1.001)
        low = int(position)
        out[n] = maps[low, row, column] * (low + 1.0 - position) + maps[low + 1, row, column] * (
            position - low
        )


def drop_duplicates(all_of_them: Hypotheses) -> Hypotheses:
    """Keep the best of the hypotheses of each bubble.

    Hypotheses of one bubble are closer than half a radius across and two along, and have similar
    radii.
    """
    center, radius, vote = all_of_them.center_mm, all_of_them.radius_mm, all_of_them.vote
    if not len(vote):
        return all_of_them
    order = np.argsort(-vote, kind="stable")
    squeezed = center * [1.0, 1.0, 0.35]
    tree, alive, keep = cKDTree(squeezed), np.ones(len(vote), dtype=np.bool_), []
    for n in order:
        if not alive[n]:
            continue
        keep.append(n)
        near = np.array(tree.query_ball_point(squeezed[n], 0.6 * radius[n] + 0.1))
        alive[near[(radius[near] < 1.6 * radius[n]) & (radius[near] > radius[n] / 1.6)]] = False
    return Hypotheses(center[keep], radius[keep], vote[keep], all_of_them.aspect[keep])
