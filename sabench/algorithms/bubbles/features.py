"""Feature potentials of refocused stacks, their peaks, and depths of outlines.

Source: J. Belden's thesis, sections 5.3 and 5.4. All steps work on darkness, one less the images'
transmission: the thesis's minimum images are images of the largest darkness here.

In section 5.4.3 a group is a chain of peaks, each within half a window and ten planes of another
one. Among many bubbles such chains run from one to the next, and their mean depth is that of none;
here a group reaches at most ten planes from its strongest peak, and as far sideways as the largest
bubble.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import binary_fill_holes, label

from sabench.algorithms.bubbles.backlit_images import DIM, transmission
from sabench.algorithms.bubbles.ellipse_detection import compute_gradient
from sabench.algorithms.refocus import refocus_log2
from sabench.api import Observation
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

WINDOW = 7  # voxels: l_x = l_y
STACK = 50  # planes of a minimum image
_SHARP = 2.0  # v of equation 5.15 for a window of unit variance


def darkness(case: Observation) -> F32:
    """Refocus darkness by the multiplicative stack of equation 5.7 with n = 1/3.

    The result is (z, y, x), from 0 to 1. The factors are the images' darkness. A product of bright
    images is dark wherever any one of them is. In the thesis, a camera with a blocked view must
    not prevent an object from coming into focus.
    """
    images = np.clip(1.0 - transmission(case), DIM, 1.0)
    volume = refocus_log2(images, case.cameras, case.grid, DIM, outside=DIM)
    volume *= 1.0 / 3.0
    return np.asarray(np.exp2(volume, out=volume))


def compute_potential(volume: F32, step: int, flat: float = DIM) -> F32:
    """Compute the feature potential E of equations 5.15 and 5.16.

    Returns (z, window rows, window columns) for windows `step` voxels apart; 0 where the spread is
    below `flat`.
    """
    rows, columns = (max(1, (size - WINDOW) // step + 1) for size in volume.shape[1:])
    out = np.zeros((volume.shape[0], rows, columns), dtype=np.float32)
    on_cores(_potential, out.shape[1] * out.shape[2], volume, step, flat, out)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _potential(jobs: slice, volume: Any, step: int, flat: float, out: Any) -> None:
    planes, height, width = volume.shape
    for window in range(jobs.start, jobs.stop):
        i, j = window // out.shape[2], window % out.shape[2]
        top, left = i * step, j * step
        bottom, right = min(top + WINDOW, height), min(left + WINDOW, width)
        total = square = 0.0
        for z in range(planes):
            for y in range(top, bottom):
                for x in range(left, right):
                    total += volume[z, y, x]
                    square += volume[z, y, x] ** 2
        count = planes * (bottom - top) * (right - left)
        spread = np.sqrt(max(square / count - (total / count) ** 2, 0.0))
        if spread < flat:
            continue
        for z in range(planes):
            across = along = 0.0
            for y in range(top, bottom):
                for x in range(left, right):
                    gx = (
                        abs(volume[z, y, min(x + 1, width - 1)] - volume[z, y, max(x - 1, 0)])
                        * 0.5
                        / spread
                    )
                    gy = (
                        abs(volume[z, min(y + 1, height - 1), x] - volume[z, max(y - 1, 0), x])
                        * 0.5
                        / spread
                    )
                    across += gx * np.exp(gx / _SHARP)
                    along += gy * np.exp(gy / _SHARP)
            out[z, i, j] = max(across, along)


def attenuate(volume: F32, potential: F32, step: int) -> None:
    """Multiply planes, in place, by the cumulative distribution of E over depth."""
    order = np.argsort(np.argsort(potential, axis=0, kind="stable"), axis=0, kind="stable")
    share = ((order + 1) / len(potential)).astype(np.float32)
    share[:, potential.max(axis=0) == 0.0] = 0.0
    offset = WINDOW / 2.0 - 0.5
    y, x = (
        ((np.arange(size, dtype=np.float32) - offset) / step).astype(np.float32)
        for size in volume.shape[1:]
    )
    columns, rows = np.meshgrid(x, y)
    for plane, part in zip(volume, np.ascontiguousarray(share), strict=True):
        plane *= cv2.remap(part, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


@dataclass(frozen=True)
class Outlines:
    """Column, row, semi-axes (n, 4) in voxels, and depth index (n,)."""

    shapes: F64
    depth: F64


def find_outlines(dark: F32, depth: F32, least: float, small: float) -> Outlines:
    """Find bubbles of one image of darkness (rows, columns) with its map of depths.

    The steps are edges, labels, circles of large features and thresholds of small ones.

    Parameters
    ----------
    least : gradient of darkness per voxel that makes an edge.
    small : equivalent diameter in voxels below which a feature is thresholded.
    """
    right, down, labels, stats = _label_edges(dark, least)
    ellipses = []
    for number, (left, top, width, height, area) in enumerate(stats[1:], start=1):
        if area <= 3:
            continue
        box = _grow_box(left, top, width, height)
        feature = labels[box] == number
        shapes = []
        if 2.0 * np.sqrt(binary_fill_holes(feature).sum() / np.pi) >= small:
            shapes = find_circles(right[box], down[box], feature)
        # a circle without votes is too small for them
        for x, y, a, b in shapes or _threshold(dark[box]):
            ellipses.append((x + box[1].start, y + box[0].start, a, b))
    outlines = np.array(ellipses, dtype=np.float64).reshape(-1, 4)
    return Outlines(outlines, np.array([_depth_of(shape, dark, depth) for shape in outlines]))


def _label_edges(dark: F32, least: float) -> tuple[F32, F32, Any, Any]:
    """Return an image's gradient, labels of its edges, and their statistics."""
    right, down = compute_gradient(dark, cv2.BORDER_DEFAULT)
    edges = (cv2.magnitude(right, down) > least).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(edges, connectivity=8)
    return right, down, labels, stats


def _grow_box(left: int, top: int, width: int, height: int) -> tuple[slice, slice]:
    """Make slices of rows and columns that reach two pixels beyond a box."""
    return slice(max(top - 2, 0), top + height + 2), slice(max(left - 2, 0), left + width + 2)


def _threshold(dark: F32) -> list[tuple[float, float, float, float]]:
    """List regions darker than their mean as circles; none for a uniform region."""
    inside = dark > dark.mean()
    if not inside.any():
        return []
    rows, columns = np.nonzero(inside)
    radius = float(np.sqrt(inside.sum() / np.pi))
    return [(float(columns.mean()), float(rows.mean()), radius, radius)]


def find_blots(dark: F32, least: float, small: float) -> list[tuple[float, float, float]]:
    """Find column, row and radius of features below `small` voxels."""
    *_, stats = _label_edges(dark, least)
    out = []
    for left, top, width, height, area in stats[1:]:
        inside = left > 0 and top > 0 and left + width < dark.shape[1]
        if area <= 3 or not inside or top + height == dark.shape[0]:
            continue
        box = _grow_box(left, top, width, height)
        out += [
            (x + box[1].start, y + box[0].start, r)
            for x, y, r, _ in _threshold(dark[box])
            if 2.0 * r < small
        ]
    return out


def find_circles(right: F32, down: F32, feature: Any) -> list[tuple[float, float, float, float]]:
    """Find circles of one feature by votes of its edge pixels along their gradients.

    Votes go towards the dark side; there are several circles if several are supported.
    """
    rows, columns = np.nonzero(feature)
    gx, gy = right[rows, columns], down[rows, columns]
    length = np.hypot(gx, gy)
    largest = int(np.ceil(0.75 * max(feature.shape))) + 1
    votes = np.zeros((largest, feature.shape[0], feature.shape[1]), dtype=np.float32)
    _vote(rows, columns, gx / length, gy / length, votes)
    out = []
    for _ in range(8):
        smooth = cv2.GaussianBlur(votes.max(axis=0), (0, 0), 0.8)
        row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
        around = (
            slice(max(row - 1, 0), min(row + 2, feature.shape[0])),
            slice(max(column - 1, 0), min(column + 2, feature.shape[1])),
        )
        profile = votes[:, *around].sum(axis=(1, 2))
        radii = np.arange(1, largest + 1)
        score = profile / (2.0 * np.pi * radii)
        radius = int(score.argmax()) + 1
        if score[radius - 1] < 0.35 or radius < 2:
            break
        near = slice(max(radius - 2, 0), radius + 1)
        r = float(np.sum(profile[near] * radii[near]) / profile[near].sum())
        ys, xs = np.mgrid[around]
        weight = votes[near, *around].sum(axis=0)
        x, y = (float(np.sum(weight * axis) / weight.sum()) for axis in (xs, ys))
        out.append((x, y, r, r))
        left = np.abs(np.hypot(columns - column, rows - row) - r) >= 1.5
        if left.sum() < 6:
            break
        rows, columns, gx, gy, length = (a[left] for a in (rows, columns, gx, gy, length))
        votes[:] = 0.0
        _vote(rows, columns, gx / length, gy / length, votes)
    return out


@numba.njit(cache=True, error_model="numpy")
def _vote(rows: Any, columns: Any, gx: Any, gy: Any, votes: Any) -> None:
    """Vote by each edge pixel for the centres of circles that are dark inside."""
    for n in range(len(rows)):
        for r in range(1, votes.shape[0] + 1):
            x, y = int(np.rint(columns[n] + r * gx[n])), int(np.rint(rows[n] + r * gy[n]))
            if 0 <= x < votes.shape[2] and 0 <= y < votes.shape[1]:
                votes[r - 1, y, x] += 1.0


def _depth_of(shape: F64, dark: F32, depth: F32) -> float:
    """Average the depths on an outline's rim, weighted with the darkness."""
    x, y, a, b = shape
    margin = 2
    top, bottom = max(int(y - b) - margin, 0), min(int(y + b) + margin + 1, dark.shape[0])
    left, right = max(int(x - a) - margin, 0), min(int(x + a) + margin + 1, dark.shape[1])
    rows, columns = np.mgrid[top:bottom, left:right]
    part = np.sqrt(((columns - x) / (a + 1.0)) ** 2 + ((rows - y) / (b + 1.0)) ** 2)
    weight = np.where(part <= 1.0, dark[top:bottom, left:right], 0.0)
    return float(np.sum(weight * depth[top:bottom, left:right]) / max(float(weight.sum()), 1e-9))


def minimum_images(volume: F32) -> list[tuple[F32, F32]]:
    """Compute the largest darkness over every `STACK` planes and its plane's index."""
    out = []
    for first in range(0, len(volume), STACK):
        planes = volume[first : first + STACK]
        out.append((planes.max(axis=0), (planes.argmax(axis=0) + first).astype(np.float32)))
    return out


def merge_overlaps(shapes: F64, grid: Grid) -> F64:
    """Remove bubbles inside larger ones.

    Bubbles are (n, 6): x, y, z, two semi-axes, weight; all lengths are in mm. Others that overlap
    are merged: two overlap if they do so in the plane and their depths differ by less than the
    larger one's radius and a stack.
    """
    order = np.argsort(-shapes[:, 3], kind="stable")
    reach = STACK * grid.voxel_mm[2] * 0.5
    merged: list[F64] = []
    for disc in shapes[order]:
        for number, other in enumerate(merged):
            apart = float(np.hypot(disc[0] - other[0], disc[1] - other[1]))
            if abs(disc[2] - other[2]) > max(other[3], reach) or apart > 0.8 * (disc[3] + other[3]):
                continue
            if apart + disc[3] <= 1.1 * other[3] or disc[3] < other[3] / 1.5:
                break
            weight = other[5] + disc[5]
            merged[number] = np.append((other[:5] * other[5] + disc[:5] * disc[5]) / weight, weight)
            break
        else:
            merged.append(disc)
    return np.array(merged).reshape(-1, 6)


STEP = WINDOW // 2  # voxels between windows that overlap by half
PLANES = 10  # from a group's strongest peak to the others
_OVERLAP = 0.8  # of the larger one's semi-axis: bubbles with nearer centres are one
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
    """Find the plane, to a fraction, where the rim of an outline is darkest.

    The rim is the part inside the outline within a voxel of it. The plane is the mean of those
    around the darkest one, weighted with the square of their mean darkness.

    Parameters
    ----------
    volume : darkness (z, y, x).
    outline : column, row, semi-axes, angle in voxels.
    plane : middle of the search; it covers `PLANES` on both sides.
    """
    rows, columns, inside = _inside(volume.shape[1:], outline)
    first = max(plane - PLANES, 0)
    stack = volume[first : plane + PLANES + 1, rows, columns][:, inside]
    if not stack.size:
        return float(plane)
    dark = stack.mean(axis=1, dtype=np.float64)
    index = np.arange(len(dark))
    weight = np.where(np.abs(index - dark.argmax()) <= PLANES // 2, dark**2, 0.0)
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
    merged: list[F64] = []
    for bubble in bubbles[np.argsort(-bubbles[:, 2], kind="stable")]:
        for peer in merged:
            if np.linalg.norm((bubble - peer)[[0, 1, 6]] * [1.0, 1.0, depth]) > _OVERLAP * peer[2]:
                continue
            if _LARGER * bubble[2] >= peer[2]:
                share = bubble[5] / max(bubble[5] + peer[5], 1e-9)
                peer[[0, 1, 2, 3, 6]] += share * (bubble - peer)[[0, 1, 2, 3, 6]]
                peer[5] = max(bubble[5], peer[5])
            break
        else:
            merged.append(bubble.copy())
    return np.array(merged, dtype=np.float64).reshape(-1, 7)
