"""Errors of cameras from sets of particle images that are mostly wrong.

The cameras are a few pixels off. Sets of images that may be one particle's are matched between
them; the right sets agree, the wrong ones scatter.

Source: B. Wieneke, Volume self-calibration for 3D particle image velocimetry, Exp. Fluids 45,
549-556, 2008.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.algorithms.particles.matching import follow_lines, is_among, move_to_pixel
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point, project_points
from sabench.images.peaks import Peaks, find_near
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba

_CELL_PX = 1.0  # edge of the cells that count sets
_SPOT_PX = 0.6  # radius of what belongs together
_AROUND_PX = 1.5  # as far as a search for the middle of a spot goes
# crowded cells in which the middle of a spot is searched for, and steps of the search
_TRIED, _SHIFTS = 20, 10
SETS = 1_000_000
_STEP_PX = 1.5  # between positions on a line of sight, as the other cameras see them
_PARTS = 3  # of the box along x and along y, each with a disparity of its own
_FEW = 100  # sets below which a part has none
_NEAR = 64  # particle images looked at around one position


@dataclass(frozen=True)
class Sets:
    """Sets of particle images.

    Positions (n, 3) from -1 to 1 in the box, numbers (n, cameras) of the images, and errors (n,
    cameras, 2) in px.
    """

    positions: F64
    hits: I64
    errors: F64


def find_sets(maps: VolumePolynomials, peaks: tuple[Peaks, ...], reach_px: float) -> Sets:
    """Find sets of peaks within a radius, and the errors of their images.

    Errors are distances from the projections of the position that fits best. If sets are too many,
    only those of a random part of the first camera's images are found, which keeps the shares of
    right and wrong sets.
    """
    along, steps = follow_lines(maps, range(len(peaks)), _STEP_PX)
    positions, errors = np.empty((SETS, 3)), np.empty((SETS, len(peaks), 2))
    hits = np.empty((SETS, len(peaks)), dtype=np.int32)
    order = np.random.default_rng(0).permutation(len(peaks[0].pixels))
    count = match_peaks(maps, peaks, order, reach_px, along, steps, positions, hits, errors)
    return Sets(positions[:count].copy(), hits[:count].astype(np.int64), errors[:count].copy())


def correct(maps: VolumePolynomials, sets: Sets, cameras: range) -> tuple[VolumePolynomials, float]:
    """Move the cameras' polynomials by their disparity; return the largest, px.

    All cameras' errors together are one vector. The part that a change of position
    explains is projected out. In the few dimensions that are left, the right sets lie in one spot
    and the wrong ones scatter. Every part of the box with enough sets near that spot has a
    disparity of its own; a plane is fitted to these.
    """
    basis = _unobservable_shifts(maps, cameras)
    errors = sets.errors.reshape(len(sets.errors), -1) @ basis
    whole = densest(errors)
    rows, spots = _by_parts(sets.positions, errors, whole)
    shifts = (spots @ basis.T).reshape(len(spots), len(cameras), 2)
    coefficients, most = maps.coefficients.copy(), 0.0
    terms = [
        int(np.flatnonzero((maps.powers == powers).all(axis=1))[0])
        for powers in ((0, 0, 0), (1, 0, 0), (0, 1, 0))
    ]
    for number, camera in enumerate(cameras):
        plane = np.linalg.lstsq(rows, shifts[:, number], rcond=None)[0]
        for term, move in zip(terms, plane, strict=False):
            coefficients[camera, term] += move
        most = max(most, float(np.linalg.norm(rows @ plane, axis=1).max()))
    return maps._replace(coefficients=coefficients), most


def densest(values: F64) -> F64:
    """Find the middle (d,) of the most crowded spot of values (n, d)."""
    cells = np.floor(values / _CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0)
    keys = np.ravel_multi_index(tuple(cells.T), tuple((cells.max(axis=0) + 1).tolist()))
    occupied, counts = np.unique(keys, return_counts=True)
    best, most = np.asarray(values.mean(axis=0), dtype=np.float64), -1
    for key in occupied[np.argsort(-counts, kind="stable")[:_TRIED]]:
        start = values[keys == key].mean(axis=0)
        near = values[(np.abs(values - start) <= _AROUND_PX).all(axis=1)]
        middle, count = _shift_mean(near, start)
        if count > most:
            best, most = middle, count
    return best


def _shift_mean(values: F64, middle: F64) -> tuple[F64, int]:
    """Shift a point repeatedly to the mean of the values near it; count these."""
    near = np.zeros(len(values), dtype=np.bool_)
    for _ in range(_SHIFTS):
        near = np.linalg.norm(values - middle, axis=1) <= _SPOT_PX
        if not near.any():
            break
        middle = values[near].mean(axis=0)
    return middle, int(near.sum())


def _unobservable_shifts(maps: VolumePolynomials, cameras: range) -> F64:
    """Compute a basis (2 cameras, d) of pixel changes that no position causes."""
    if len(cameras) < 2:
        return np.eye(2)
    nearby = 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    pixels = np.stack([project_points(maps, camera, nearby) for camera in cameras])
    slopes = (pixels[:, :3] - pixels[:, 3:]).transpose(0, 2, 1).reshape(-1, 3)
    return np.asarray(np.linalg.svd(slopes)[0][:, 3:])


def _by_parts(positions: F64, errors: F64, whole: F64) -> tuple[F64, F64]:
    """Compute rows (1, x, y) of the parts' middles, or (1,), and their spots."""
    near = np.linalg.norm(errors - whole, axis=1) <= 2.0 * _SPOT_PX
    cell = ((positions[:, :2] + 1.0) / 2.0 * _PARTS).astype(int)
    part = np.clip(cell, 0, _PARTS - 1) @ [1, _PARTS]
    chosen = [np.flatnonzero(near & (part == number)) for number in range(_PARTS**2)]
    if min(map(len, chosen)) < _FEW:
        return np.ones((1, 1)), whole[None]
    middles = np.array([positions[rows, :2].mean(axis=0) for rows in chosen])
    spots = np.stack([_shift_mean(errors[rows], whole)[0] for rows in chosen])
    return np.column_stack([np.ones(len(chosen)), middles]), spots


@inner_kernel()
def _gains(slopes: Any, cameras: int, gains: Any) -> bool:
    """Fill in a position's displacement (camera, 2, 3) per pixel of error."""
    m = np.zeros((3, 3))
    for c in range(cameras):
        for a in range(2):
            for p in range(3):
                for q in range(3):
                    m[p, q] += slopes[c, a, p] * slopes[c, a, q]
    cross = np.empty((3, 3))
    for p in range(3):
        i, j = (p + 1) % 3, (p + 2) % 3
        for q in range(3):
            k, n = (q + 1) % 3, (q + 2) % 3
            cross[p, q] = m[i, k] * m[j, n] - m[i, n] * m[j, k]
    determinant = m[0, 0] * cross[0, 0] + m[0, 1] * cross[0, 1] + m[0, 2] * cross[0, 2]
    if determinant <= 1e-9 * (m[0, 0] * m[1, 1] * m[2, 2]):
        return False
    for c in range(cameras):
        for a in range(2):
            for p in range(3):
                s = slopes[c, a]
                sum_ = cross[p, 0] * s[0] + cross[p, 1] * s[1] + cross[p, 2] * s[2]
                gains[c, a, p] = sum_ / determinant
    return True


@inner_kernel()
def _compute_step(gains: Any, misses: Any, cameras: int, step: Any) -> None:
    """Compute the step (3,) of a position that lowers the squared misses most."""
    for p in range(3):
        step[p] = 0.0
        for c in range(cameras):
            step[p] += gains[c, 0, p] * misses[c, 0] + gains[c, 1, p] * misses[c, 1]


@numba.njit(cache=True)
def match_peaks(
    maps: Any,
    peaks: Any,
    order: Any,
    radius: float,
    along: int,
    steps: int,
    positions: Any,
    hits: Any,
    errors: Any,
) -> int:
    """Fill in sets of peaks that may be one particle; return how many there are.

    A set has one peak of each of three or four cameras.

    The first camera's line of sight is followed through the box and intersected with those of the
    second camera's images within the radius. Images of the other cameras within the radius around
    this position complete a set. A set counts if no camera misses the position that fits it best by
    more than `radius`. When the arrays are full, the rest of the first camera's images is left out.

    Parameters
    ----------
    peaks : one `Peaks` of each camera.
    order : numbers of the first camera's images, in the order of the search.
    along, steps : axis and number of positions on a line of sight, from `follow_lines`.
    positions : (sets, 3) filled with the positions, x, y, z from -1 to 1.
    hits : (sets, cameras) filled with the numbers of the images.
    errors : (sets, cameras, 2) filled with the images' offsets from the projections of the
        position, px.
    """
    cameras = len(peaks)
    count: Any = np.int64(0)  # for a literal 0, all that takes it would be compiled once more
    position, here, slope = np.zeros(3), np.zeros(2), np.zeros((2, 3))
    chosen = np.zeros(cameras, dtype=np.int64)
    slopes, gains = np.zeros((cameras, 2, 3)), np.zeros((cameras, 2, 3))
    work = slopes, np.zeros((cameras, 2)), gains, np.zeros(3)
    sets = positions, hits, errors
    second, tried = np.zeros(_NEAR, dtype=np.int64), np.zeros(_NEAR, dtype=np.int64)
    for first in order:
        if count == len(positions):
            break
        chosen[0], left = first, 0
        position[:] = 0.0
        for n in range(steps):
            position[along] = -1.0 + 2.0 * n / (steps - 1)
            if not move_to_pixel(maps, peaks[0].pixels[first], position, along, here, slope):
                position[:] = 0.0
                continue
            project_point(maps, 1, position, here, slope)
            for k in range(find_near(peaks[1], here, radius, second)):
                chosen[1] = second[k]
                if is_among(tried, min(left, _NEAR), second[k]):
                    continue
                tried[left % _NEAR] = second[k]
                left += 1
                start = position.copy()
                if _intersect(maps, peaks, chosen, start, work, here):
                    count = _others(maps, peaks, radius, chosen, start, work, sets, count)
    return int(count)


@inner_kernel()
def _intersect(maps: Any, peaks: Any, chosen: Any, position: Any, work: Any, here: Any) -> bool:
    """Move a point nearest to two lines of sight; False outside the box."""
    slopes, misses, gains, step = work
    for _ in range(2):
        for c in range(2):
            project_point(maps, c, position, here, slopes[c])
            for a in range(2):
                misses[c, a] = peaks[c].pixels[chosen[c], a] - here[a]
        if not _gains(slopes, 2, gains):
            return False
        _compute_step(gains, misses, 2, step)
        for p in range(3):
            position[p] += step[p]
    return bool(abs(position[0]) <= 1.0 and abs(position[1]) <= 1.0 and abs(position[2]) <= 1.0)


@inner_kernel()
def _others(
    maps: Any, peaks: Any, radius: float, chosen: Any, start: Any, work: Any, sets: Any, count: int
) -> int:
    """Try all images of the other cameras near a position; return the number of sets."""
    (slopes, misses, gains, step), (positions, hits, errors) = work, sets
    cameras = len(peaks)
    projected, nearby = np.zeros((cameras, 2)), np.zeros((2, _NEAR), dtype=np.int64)
    numbers = np.ones(2, dtype=np.int64)
    for c in range(cameras):
        project_point(maps, c, start, projected[c], slopes[c])
        if c >= 2:
            numbers[c - 2] = find_near(peaks[c], projected[c], radius, nearby[c - 2])
    if numbers[0] * numbers[1] == 0 or not _gains(slopes, cameras, gains):
        return count
    for c in range(2):
        for a in range(2):
            misses[c, a] = peaks[c].pixels[chosen[c], a] - projected[c, a]
    for both in range(numbers[0] * numbers[1]):
        for c in range(2, cameras):
            chosen[c] = nearby[0, both // numbers[1]] if c == 2 else nearby[1, both % numbers[1]]
            misses[c, 0] = peaks[c].pixels[chosen[c], 0] - projected[c, 0]
            misses[c, 1] = peaks[c].pixels[chosen[c], 1] - projected[c, 1]
        _compute_step(gains, misses, cameras, step)
        if _worst(slopes, misses, step, cameras) <= radius * radius:
            if count == len(positions):
                return count
            for p in range(3):
                positions[count, p] = start[p] + step[p]
            for c in range(cameras):
                hits[count, c] = chosen[c]
                for a in range(2):
                    s = slopes[c, a]
                    errors[count, c, a] = misses[c, a] - (
                        s[0] * step[0] + s[1] * step[1] + s[2] * step[2]
                    )
            count += 1
    return count


@inner_kernel()
def _worst(slopes: Any, misses: Any, step: Any, cameras: int) -> float:
    """Compute the largest squared miss of a camera at a position after a step."""
    worst = 0.0
    for c in range(cameras):
        square = 0.0
        for a in range(2):
            s = slopes[c, a]
            off = misses[c, a] - s[0] * step[0] - s[1] * step[1] - s[2] * step[2]
            square += off * off
        worst = max(worst, square)
    return worst


@numba.njit(cache=True)
def pair_up(peaks: Any, pixels: Any, radius: float, out: Any) -> int:
    """Fill in pairs (pixel, peak) within a radius while they fit; count them."""
    nearby, count = np.zeros(len(peaks.pixels), dtype=np.int64), 0
    for n in range(len(pixels)):
        for k in range(find_near(peaks, pixels[n], radius, nearby)):
            if count == len(out):
                return count
            out[count, 0], out[count, 1] = n, nearby[k]
            count += 1
    return count
