"""Triangulation of positions that particle images of several cameras agree on.

The line of sight of a camera's particle image is followed through the volume and intersected with
those of nearby images of a second camera. The other cameras must have an image where they see the
intersection. Source: Maas, Gruen and Papantoniou, Particle tracking velocimetry in
three-dimensional flows, Part 1, Exp. Fluids 15, 133-146, 1993. Unlike there, polynomials
approximate the refracted lines of sight, and there are no pairs of candidate lists.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sabench.algorithms.particles.correspondence import follow_lines, move_to_pixel
from sabench.algorithms.particles.time_budget import Deadline
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point
from sabench.images.peaks import Peaks, find_near
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.compiled import numba

_NEAR = 64  # particle images looked at around one position
_ROOM = 50  # sets of each of the first camera's images for which memory is allocated
_STEPS = 2  # of the least-squares fit of a position
_BATCH = 64  # of the first camera's images between two looks at the clock
_SEARCHED = 1.5  # times the reach: radius in which images are looked for


class Candidates(NamedTuple):
    """Sets of particle images that may be one particle's.

    Attributes
    ----------
    position : (n, 3) in the box of the maps, from -1 to 1.
    hit : (n, cameras) numbers of the images; -1 where a camera shows none.
    error_px : (n,) root mean square distance of the images from where the cameras see the position.
    """

    position: F64
    hit: I64
    error_px: F64


def find_candidates(
    maps: VolumePolynomials,
    peaks: tuple[Peaks, ...],
    reach_px: float,
    covered: Bool,
    order: I64 | None = None,
    deadline: Deadline | None = None,
) -> Candidates:
    """Find all sets of peaks that agree on a position within `reach_px`.

    Every camera that has the position on its sensor must show a peak there. At the deadline, the
    sets of the first camera's remaining peaks are left out.

    Parameters
    ----------
    peaks : of each camera.
    covered : (camera, row, column) pixels where a camera can show nothing.
    order : numbers of the first camera's peaks in the order in which they are searched; by default
        all of them.
    deadline : by default none.
    """
    order = np.arange(len(peaks[0].pixels)) if order is None else order
    along, steps = follow_lines(maps, range(1, 2), reach_px)
    found = [_empty(0, len(peaks))]
    for start in range(0, len(order), _BATCH):
        if deadline is not None and deadline.over:
            break
        own = np.ascontiguousarray(order[start : start + _BATCH])
        room = _empty(_ROOM * len(own), len(peaks))
        count = _follow(maps, peaks, reach_px, covered, along, steps, own, *room)
        found.append(select_rows(room, np.arange(count)))
    return Candidates(
        np.concatenate([one.position for one in found]),
        np.concatenate([one.hit for one in found]),
        np.concatenate([one.error_px for one in found]),
    )


def select_rows(found: Candidates, rows: I64) -> Candidates:
    """Copy some of the candidates."""
    return Candidates(found.position[rows], found.hit[rows], found.error_px[rows])


def _empty(count: int, cameras: int) -> Candidates:
    return Candidates(
        np.zeros((count, 3)), np.full((count, cameras), -1, dtype=np.int64), np.zeros(count)
    )


def count_by_chance(
    maps: VolumePolynomials, peaks: tuple[Peaks, ...], reach_px: float, pixels: int
) -> float:
    """Estimate how many sets that agree by chance contain a peak of the first camera.

    Peaks of the others are taken as spread evenly over images of so many pixels.
    """
    steps = follow_lines(maps, range(1, 2), reach_px)[1]
    density = np.array([len(own.pixels) / pixels for own in peaks[1:]])
    near = _SEARCHED * reach_px
    line = density[0] * 2.0 * near * steps * reach_px
    return float(line * np.prod(1.0 - np.exp(-density[1:] * np.pi * near**2)))


def select_best(found: Candidates, peaks: tuple[Peaks, ...]) -> I64:
    """Select candidates so that each peak belongs to one only.

    Complete sets come before others, and those that fit best first; returns rows.
    """
    order = np.lexsort((found.error_px, (found.hit < 0).sum(axis=1)))
    free = [
        np.ones(len(one.pixels) + 1, dtype=bool) for one in peaks
    ]  # the last one is that of a camera that shows none
    kept = []
    for row in order:
        if all(flags[number] for flags, number in zip(free, found.hit[row], strict=True)):
            kept.append(row)
            for flags, number in zip(free, found.hit[row], strict=True):
                flags[number] = number < 0
    return np.array(kept, dtype=np.int64)


@numba.njit(cache=True)
def _follow(
    maps: Any,
    peaks: Any,
    radius: float,
    covered: Any,
    along: int,
    steps: int,
    order: Any,
    positions: Any,
    hits: Any,
    errors: Any,
) -> int:
    """Fill in the candidates of the first camera's images with these numbers.

    Returns how many there are.
    """
    cameras, count = len(peaks), 0
    position, start, here, slope = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros((2, 3))
    near, tried, chosen = (
        np.zeros(_NEAR, dtype=np.int64),
        np.zeros(512, dtype=np.int64),
        np.zeros(cameras, dtype=np.int64),
    )
    for first in order:
        left = 0
        position[:] = 0.0
        for n in range(steps):
            position[along] = -1.0 + 2.0 * n / (steps - 1)
            if not move_to_pixel(maps, peaks[0].pixels[first], position, along, here, slope):
                position[:] = 0.0
                continue
            project_point(maps, 1, position, here, slope)
            for k in range(find_near(peaks[1], here, _SEARCHED * radius, near)):
                if left == len(tried) or count == len(positions) or _has(tried, left, near[k]):
                    continue
                tried[left] = near[k]
                left += 1
                chosen[:] = -1
                chosen[0], chosen[1] = first, near[k]
                for i in range(3):
                    start[i] = position[i]
                worst = _fit_position(maps, peaks, chosen, start)
                if (
                    worst > radius
                    or not _within(start, 1.0)
                    or not _others(maps, peaks, chosen, start, radius, covered)
                ):
                    continue
                worst = _fit_position(maps, peaks, chosen, start)
                if worst <= radius and _within(start, 1.0):
                    for i in range(3):
                        positions[count, i] = start[i]
                    for c in range(cameras):
                        hits[count, c] = chosen[c]
                    errors[count] = _error(maps, peaks, chosen, start)
                    count += 1
    return count


@numba.njit(cache=True)
def _has(values: Any, count: int, value: int) -> bool:
    """Say whether a value is among the first ones.

    Loops like this one take less time to compile than expressions of arrays.
    """
    found = False
    for n in range(count):
        found |= values[n] == value
    return found


@numba.njit(cache=True)
def _within(position: Any, bound: float) -> bool:
    """Say whether no coordinate is beyond a bound."""
    inside = True
    for i in range(3):
        inside &= abs(position[i]) <= bound
    return inside


@numba.njit(cache=True)
def _others(
    maps: Any,
    peaks: Any,
    chosen: Any,
    position: Any,
    radius: float,
    covered: Any,
) -> bool:
    """Choose the image nearest to a position in each camera after the first two.

    Returns False if one shows none and has it on its sensor, uncovered.
    """
    here, slope, near = np.zeros(2), np.zeros((2, 3)), np.zeros(_NEAR, dtype=np.int64)
    for c in range(2, len(peaks)):
        project_point(maps, c, position, here, slope)
        nearest = radius * _SEARCHED
        for k in range(find_near(peaks[c], here, nearest, near)):
            apart = np.hypot(
                peaks[c].pixels[near[k], 0] - here[0], peaks[c].pixels[near[k], 1] - here[1]
            )
            if apart < nearest:
                nearest, chosen[c] = apart, near[k]
        if chosen[c] < 0 and _open(covered[c], here):
            return False
    showing = 0
    for c in range(len(peaks)):
        showing += chosen[c] >= 0
    return len(peaks) == 2 or showing > 2


@numba.njit(cache=True)
def _open(covered: Any, pixel: Any) -> bool:
    """Say whether a pixel is on the sensor and not covered."""
    rows, columns = covered.shape
    if not (0.0 < pixel[0] < columns - 1.0 and 0.0 < pixel[1] < rows - 1.0):
        return False
    return not covered[int(np.rint(pixel[1])), int(np.rint(pixel[0]))]


@numba.njit(cache=True)
def _fit_position(maps: Any, peaks: Any, chosen: Any, position: Any) -> float:
    """Move a position to where it fits the chosen images best.

    Returns the largest distance that is left, px.
    """
    here, slope, matrix, right, worst = (
        np.zeros(2),
        np.zeros((2, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
        0.0,
    )
    for step in range(_STEPS + 1):
        matrix[:], right[:], worst = 0.0, 0.0, 0.0
        for c in range(len(peaks)):
            if chosen[c] < 0:
                continue
            project_point(maps, c, position, here, slope)
            miss = peaks[c].pixels[chosen[c]] - here
            worst = max(worst, np.hypot(miss[0], miss[1]))
            for a in range(2):
                for i in range(3):
                    right[i] += slope[a, i] * miss[a]
                    for j in range(3):
                        matrix[i, j] += slope[a, i] * slope[a, j]
        if (
            step == _STEPS
            or np.linalg.det(matrix) <= 1e-9 * matrix[0, 0] * matrix[1, 1] * matrix[2, 2]
        ):
            break
        position += np.linalg.solve(matrix, right)
        if not _within(position, 1.5):
            return np.inf
    return worst


@numba.njit(cache=True)
def _error(maps: Any, peaks: Any, chosen: Any, position: Any) -> float:
    here, slope, total, seen = np.zeros(2), np.zeros((2, 3)), 0.0, 0
    for c in range(len(peaks)):
        if chosen[c] >= 0:
            project_point(maps, c, position, here, slope)
            miss = peaks[c].pixels[chosen[c]] - here
            total, seen = total + miss[0] ** 2 + miss[1] ** 2, seen + 1
    return float(np.sqrt(total / seen))
