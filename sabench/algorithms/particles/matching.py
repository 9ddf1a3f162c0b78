"""Matching of particle images between cameras, and their triangulation.

The line of sight of a camera's particle image is followed through the volume and intersected with
those of nearby images of a second camera. The other cameras must have an image where they see the
intersection. Source: Maas, Gruen and Papantoniou, Particle tracking velocimetry in
three-dimensional flows, Part 1, Exp. Fluids 15, 133-146, 1993. Unlike there, polynomials
approximate the refracted lines of sight, and there are no pairs of candidate lists. Points with
known matches are triangulated by `geometry.triangulation`.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from sabench.algorithms.particles.joint_fit import solve_three
from sabench.api import FoundParticles, Observation, Parameters
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    fit_volume_polynomials,
    points_in_mm,
    project_point,
    project_with_slopes,
)
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.levels import bright_dn
from sabench.images.peaks import Peaks, detect_particle_peaks, find_near, keep_peaks
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import Deadline

MARGIN = 1.0  # voxels around the grid's centres that are searched for particles
_MOST_BY_CHANCE = 5.0  # sets of particle images with each one: beyond, nearly all are ghosts
_ROOM = 64  # for particle images around a position, and for sets of each of the first camera's
_STEPS = 2  # of the least-squares fit of a position
_BATCH = 64  # of the first camera's images between two looks at the clock
SEARCHED = 1.5  # times the reach: search radius of images


class PeakParameters(Parameters):
    """Thresholds of particle images."""

    floor: float = Field(
        0.05,
        gt=0.0,
        lt=1.0,
        description="smallest peak of a particle image, over that of a bright particle",
    )
    false_alarms: float = Field(
        FALSE_ALARMS,
        gt=0.0,
        lt=0.5,
        description="probability that noise makes a particle image of a pixel; the larger of both "
        "thresholds holds",
    )


def detect_in_cameras(
    case: Observation, floor: float, false_alarms: float = FALSE_ALARMS
) -> tuple[Peaks, ...]:
    """Detect peaks of particle images in each camera by `PeakParameters`."""
    good, black, peaks = case.repaired, case.black_dn, []
    for grey, unknown in zip(good.images, good.flaws.unknown, strict=True):
        least = black + floor * bright_dn(grey, black, unknown)
        detected = detect_particle_peaks(grey, unknown, least_dn=least, false_alarms=false_alarms)
        peaks.append(detected)
    return tuple(peaks)


def heights(peaks: Peaks, image: F32) -> F32:
    """Return the image (n,) at the pixels of peaks."""
    column, row = np.rint(peaks.pixels).astype(np.int64).T
    return np.asarray(image[row, column])


def heights_of(hit: I64, peaks: tuple[Peaks, ...], images: F32) -> F64:
    """Return the brightest pixels (n, camera) of candidates' images, 0 for none.

    Parameters
    ----------
    hit : (n, camera) numbers of the peaks; -1 where a camera shows none.
    """
    out = np.zeros(hit.shape)
    for camera, (camera_peaks, image) in enumerate(zip(peaks, images, strict=True)):
        used = hit[:, camera] >= 0
        out[used, camera] = heights(camera_peaks, image)[hit[used, camera]]
    return out


@dataclass(frozen=True)
class TriangulationSettings:
    """Settings of the search for particle images and of their agreement.

    Attributes
    ----------
    floor, false_alarms : as in `PeakParameters`.
    reach_px : largest distance of an image from the particle's projection.
    budget_s : seconds for a frame, after which the particles so far are the result; None: no limit.
    """

    floor: float = 0.05
    false_alarms: float = FALSE_ALARMS
    reach_px: float = 0.8
    budget_s: float | None = None


def fit_cameras(case: Observation) -> VolumePolynomials:
    """Fit the cameras by polynomials over the grid and a margin."""
    return fit_volume_polynomials(case.cameras, *case.grid.centers_mm(MARGIN))


def triangulate_particles(
    case: Observation, maps: VolumePolynomials, settings: TriangulationSettings
) -> FoundParticles:
    """Triangulate the particles that particle images agree on, each image used once.

    The brightest images come first. A warning says if the time budget leaves some out, or if so
    many agree by chance that only the brightest are used.
    """
    deadline = Deadline(settings.budget_s)
    images = case.normalised_images()
    peaks = detect_in_cameras(case, settings.floor, settings.false_alarms)
    peaks = _thin_out(case, maps, peaks, images, settings.reach_px)
    order = np.argsort(-heights(peaks[0], images[0]), kind="stable")
    every = find_peak_sets(
        maps, peaks, settings.reach_px, case.repaired.flaws.covered, order, deadline
    )
    if deadline.over:
        warnings.warn(
            f"ray_triangulation: the time budget of {settings.budget_s:g} s a frame is spent: the "
            "result holds the particles found so far, the brightest ones first",
            stacklevel=1,
        )
    best = select_rows(every, select_best(every, peaks))
    brightness = heights_of(best.hit, peaks, images).mean(axis=1)
    return FoundParticles(points_in_mm(maps, best.position), brightness)


def _thin_out(
    case: Observation,
    maps: VolumePolynomials,
    peaks: tuple[Peaks, ...],
    images: F32,
    reach_px: float,
) -> tuple[Peaks, ...]:
    """Keep the brightest peaks where nearly all sets of them would agree by chance."""
    chance = count_by_chance(maps, peaks, reach_px, images[0].size)
    if chance <= _MOST_BY_CHANCE:
        return peaks
    share = (_MOST_BY_CHANCE / chance) ** (1.0 / (len(peaks) - 1))
    pairs = zip(peaks, images, strict=True)
    orders = [np.argsort(-heights(*pair), kind="stable") for pair in pairs]
    brightest = tuple(
        keep_peaks(camera_peaks, np.sort(order[: int(share * len(order))]))
        for camera_peaks, order in zip(peaks, orders, strict=True)
    )
    counts = ", ".join(
        f"{len(few.pixels)} of {len(camera_peaks.pixels)} in {camera.name}"
        for camera, few, camera_peaks in zip(case.cameras, brightest, peaks, strict=True)
    )
    warnings.warn(
        f"ray_triangulation: expected at most {_MOST_BY_CHANCE:g} sets of particle images that "
        f"agree by chance with each one, got {chance:.0f}: the brightest images are used "
        f"({counts}); raise floor, or lower false_alarms or reach_px",
        stacklevel=1,
    )
    return brightest


class PeakSets(NamedTuple):
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


def find_peak_sets(
    maps: VolumePolynomials,
    peaks: tuple[Peaks, ...],
    reach_px: float,
    covered: Bool,
    order: I64 | None = None,
    deadline: Deadline | None = None,
) -> PeakSets:
    """Find all sets of peaks that agree on a position within `reach_px`.

    Every camera that has the position on its sensor must show a peak there. At the deadline, the
    sets of the first camera's remaining peaks are left out.

    Parameters
    ----------
    peaks : of each camera.
    covered : (camera, row, column) pixels where a camera can show nothing.
    order : numbers of the first camera's peaks in the order of the search; by default
        all of them.
    deadline : by default none.
    """
    order = np.arange(len(peaks[0].pixels)) if order is None else order
    along, steps = follow_lines(maps, range(1, 2), reach_px)
    sets = [_empty(0, len(peaks))]
    for start in range(0, len(order), _BATCH):
        if deadline is not None and deadline.over:
            break
        batch = np.ascontiguousarray(order[start : start + _BATCH])
        room = _empty(_ROOM * len(batch), len(peaks))
        count = _follow(maps, peaks, reach_px, covered, along, steps, batch, *room)
        sets.append(select_rows(room, np.arange(count)))
    return join_sets(sets)


def select_rows(sets: PeakSets, rows: I64 | Bool) -> PeakSets:
    """Copy some of the candidates."""
    return PeakSets._make(values[rows] for values in sets)


def join_sets(parts: Sequence[PeakSets]) -> PeakSets:
    """Join candidates in the order of the parts."""
    return PeakSets(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _empty(count: int, cameras: int) -> PeakSets:
    return PeakSets(
        np.zeros((count, 3)), np.full((count, cameras), -1, dtype=np.int64), np.zeros(count)
    )


def count_by_chance(
    maps: VolumePolynomials, peaks: tuple[Peaks, ...], reach_px: float, pixels: int
) -> float:
    """Estimate how many sets contain a first camera's peak if others are uniform."""
    steps = follow_lines(maps, range(1, 2), reach_px)[1]
    density = np.array([len(camera_peaks.pixels) / pixels for camera_peaks in peaks[1:]])
    near = SEARCHED * reach_px
    line = density[0] * 2.0 * near * steps * reach_px
    return float(line * np.prod(1.0 - np.exp(-density[1:] * np.pi * near**2)))


def select_best(sets: PeakSets, peaks: tuple[Peaks, ...]) -> I64:
    """Select rows so that each peak is used once, complete sets and best fits first."""
    order = np.lexsort((sets.error_px, (sets.hit < 0).sum(axis=1)))
    # the last one is that of a camera that shows none
    free = [np.ones(len(camera_peaks.pixels) + 1, dtype=bool) for camera_peaks in peaks]
    rows = []
    for row in order:
        if all(flags[number] for flags, number in zip(free, sets.hit[row], strict=True)):
            rows.append(row)
            for flags, number in zip(free, sets.hit[row], strict=True):
                flags[number] = number < 0
    return np.array(rows, dtype=np.int64)


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
    """Fill in the candidates of these images of the first camera, and count them."""
    cameras, count = len(peaks), 0
    position, start, here, slope = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros((2, 3))
    near, tried = np.zeros(_ROOM, dtype=np.int64), np.zeros(512, dtype=np.int64)
    chosen = np.zeros(cameras, dtype=np.int64)
    for first in order:
        left = 0
        position[:] = 0.0
        for n in range(steps):
            position[along] = -1.0 + 2.0 * n / (steps - 1)
            if not move_to_pixel(maps, peaks[0].pixels[first], position, along, here, slope):
                position[:] = 0.0
                continue
            project_point(maps, 1, position, here, slope)
            for k in range(find_near(peaks[1], here, SEARCHED * radius, near)):
                if left == len(tried) or count == len(positions) or is_among(tried, left, near[k]):
                    continue
                tried[left] = near[k]
                left += 1
                chosen[:] = -1
                chosen[0], chosen[1] = first, near[k]
                for i in range(3):
                    start[i] = position[i]
                worst, _ = _fit_position(maps, peaks, chosen, start)
                if (
                    worst > radius
                    or not _within(start, 1.0)
                    or not _others(maps, peaks, chosen, start, radius, covered)
                ):
                    continue
                worst, error = _fit_position(maps, peaks, chosen, start)
                if worst <= radius and _within(start, 1.0):
                    for i in range(3):
                        positions[count, i] = start[i]
                    for c in range(cameras):
                        hits[count, c] = chosen[c]
                    errors[count] = error
                    count += 1
    return count


@inner_kernel()
def is_among(values: Any, count: int, value: int) -> bool:
    """Find a value among the first ones: a loop is faster to compile than arrays."""
    among = False
    for n in range(count):
        among |= values[n] == value
    return among


@inner_kernel()
def _within(position: Any, bound: float) -> bool:
    inside = True
    for i in range(3):
        inside &= abs(position[i]) <= bound
    return inside


@inner_kernel()
def _others(maps: Any, peaks: Any, chosen: Any, position: Any, radius: float, covered: Any) -> bool:
    """Choose the nearest image in each other camera; False if an open one shows none."""
    here, slope, near = np.zeros(2), np.zeros((2, 3)), np.zeros(_ROOM, dtype=np.int64)
    for c in range(2, len(peaks)):
        project_point(maps, c, position, here, slope)
        nearest = radius * SEARCHED
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


@inner_kernel()
def _open(covered: Any, pixel: Any) -> bool:
    rows, columns = covered.shape
    if not (0.0 < pixel[0] < columns - 1.0 and 0.0 < pixel[1] < rows - 1.0):
        return False
    return not covered[int(np.rint(pixel[1])), int(np.rint(pixel[0]))]


@inner_kernel()
def _fit_position(maps: Any, peaks: Any, chosen: Any, position: Any) -> tuple[float, float]:
    """Fit a position to the chosen images; returns largest and RMS distance left, px."""
    here, slope, worst, total, count = np.zeros(2), np.zeros((2, 3)), 0.0, 0.0, 0
    matrix, right, change = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for step in range(_STEPS + 1):
        matrix[:], right[:], worst, total, count = 0.0, 0.0, 0.0, 0.0, 0
        for c in range(len(peaks)):
            if chosen[c] < 0:
                continue
            project_point(maps, c, position, here, slope)
            found = peaks[c].pixels[chosen[c]]
            worst = max(worst, math.hypot(found[0] - here[0], found[1] - here[1]))
            total += (found[0] - here[0]) ** 2 + (found[1] - here[1]) ** 2
            count += 1
            for a in range(2):
                for i in range(3):
                    right[i] += slope[a, i] * (found[a] - here[a])
                    for j in range(3):
                        matrix[i, j] += slope[a, i] * slope[a, j]
        if step == _STEPS or solve_three(matrix, right, change) <= 0.0:
            break
        for i in range(3):
            position[i] += change[i]
        if not _within(position, 1.5):
            return np.inf, np.inf
    return worst, np.sqrt(total / count)


def follow_lines(maps: VolumePolynomials, cameras: range, step_px: float) -> tuple[int, int]:
    """Choose how the first camera's lines of sight are followed through the box.

    Returns the axis of the box along which the one in its middle runs the most, and how many
    positions along it are at most a step apart in the images of these cameras.
    """
    slopes = [project_with_slopes(maps, camera, np.zeros((1, 3)))[1][0] for camera in (0, *cameras)]
    line = np.linalg.svd(slopes[0])[2][2]
    along = int(np.argmax(np.abs(line)))
    through = 2.0 * line / abs(line[along])
    longest = max(float(np.linalg.norm(slope @ through)) for slope in slopes)
    return along, max(2, int(longest / step_px) + 2)


@inner_kernel()
def move_to_pixel(maps: Any, pixel: Any, position: Any, along: int, here: Any, slope: Any) -> bool:
    """Move a position across an axis to where the first camera sees a pixel."""
    a, b = (along + 1) % 3, (along + 2) % 3
    for _ in range(10):
        project_point(maps, 0, position, here, slope)
        du, dv = pixel[0] - here[0], pixel[1] - here[1]
        determinant = slope[0, a] * slope[1, b] - slope[0, b] * slope[1, a]
        position[a] += (slope[1, b] * du - slope[0, b] * dv) / determinant
        position[b] += (slope[0, a] * dv - slope[1, a] * du) / determinant
        if abs(du) + abs(dv) < 1e-3:
            break
    return bool(abs(position[a]) <= 1.0 and abs(position[b]) <= 1.0)
