"""Matches of particle images between cameras that are a few pixels off.

Source: B. Wieneke, Volume self-calibration for 3D particle image velocimetry, Exp. Fluids 45,
549-556, 2008.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    project_point,
    project_with_slopes,
)
from sabench.images.peaks import find_near
from sabench.utils.compiled import numba

_NEAR = 64  # particle images looked at around one position


@numba.njit(cache=True)
def _gains(slopes: Any, cameras: int, gains: Any) -> bool:
    """Fill in gains (camera, 2, 3).

    A gain is the least-squares displacement of a position for every pixel of a camera's error.
    """
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
                sum_ = (
                    cross[p, 0] * slopes[c, a, 0]
                    + cross[p, 1] * slopes[c, a, 1]
                    + cross[p, 2] * slopes[c, a, 2]
                )
                gains[c, a, p] = sum_ / determinant
    return True


@numba.njit(cache=True)
def _compute_step(gains: Any, misses: Any, cameras: int, step: Any) -> None:
    """Compute the step (3,) of a position that lowers the squared misses most."""
    for p in range(3):
        step[p] = 0.0
        for c in range(cameras):
            step[p] += gains[c, 0, p] * misses[c, 0] + gains[c, 1, p] * misses[c, 1]


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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def match(
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
    order : numbers of the first camera's images, in the order in which they are taken.
    along, steps : axis and number of positions on a line of sight, from `follow_lines`.
    positions : (sets, 3) filled with the positions, x, y, z from -1 to 1.
    hits : (sets, cameras) filled with the numbers of the images.
    errors : (sets, cameras, 2) filled with where the images lie against where the cameras see the
        position, px.
    """
    cameras = len(peaks)
    count: Any = np.int64(0)  # for a literal 0, all that takes it would be compiled once more
    position, here, slope, step = np.zeros(3), np.zeros(2), np.zeros((2, 3)), np.zeros(3)
    slopes, gains = np.zeros((cameras, 2, 3)), np.zeros((cameras, 2, 3))
    misses, chosen = np.zeros((cameras, 2)), np.zeros(cameras, dtype=np.int64)
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
                if _is_among(tried[: min(left, _NEAR)], second[k]):
                    continue
                tried[left % _NEAR] = second[k]
                left += 1
                start = position.copy()
                if _intersect(maps, peaks, chosen, start, slopes, misses, gains, here, step):
                    count = _others(
                        maps,
                        peaks,
                        radius,
                        chosen,
                        start,
                        slopes,
                        misses,
                        gains,
                        step,
                        positions,
                        hits,
                        errors,
                        count,
                    )
    return int(count)


@numba.njit(cache=True)
def _is_among(numbers: Any, number: int) -> bool:
    found = False
    for one in numbers:
        found |= one == number
    return found


@numba.njit(cache=True)
def _intersect(
    maps: Any,
    peaks: Any,
    chosen: Any,
    position: Any,
    slopes: Any,
    misses: Any,
    gains: Any,
    here: Any,
    step: Any,
) -> bool:
    """Move a point to where the lines of sight of the first two cameras come nearest.

    Returns False if that is outside the box.
    """
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


@numba.njit(cache=True)
def _others(
    maps: Any,
    peaks: Any,
    radius: float,
    chosen: Any,
    start: Any,
    slopes: Any,
    misses: Any,
    gains: Any,
    step: Any,
    positions: Any,
    hits: Any,
    errors: Any,
    count: int,
) -> int:
    """Try all images of the cameras after the second near a position.

    Returns the number of sets so far.
    """
    cameras = len(peaks)
    seen, found = np.zeros((cameras, 2)), np.zeros((2, _NEAR), dtype=np.int64)
    numbers = np.ones(2, dtype=np.int64)
    for c in range(cameras):
        project_point(maps, c, start, seen[c], slopes[c])
        if c >= 2:
            numbers[c - 2] = find_near(peaks[c], seen[c], radius, found[c - 2])
    if numbers[0] * numbers[1] == 0 or not _gains(slopes, cameras, gains):
        return count
    for c in range(2):
        for a in range(2):
            misses[c, a] = peaks[c].pixels[chosen[c], a] - seen[c, a]
    for both in range(numbers[0] * numbers[1]):
        for c in range(2, cameras):
            chosen[c] = found[0, both // numbers[1]] if c == 2 else found[1, both % numbers[1]]
            misses[c, 0] = peaks[c].pixels[chosen[c], 0] - seen[c, 0]
            misses[c, 1] = peaks[c].pixels[chosen[c], 1] - seen[c, 1]
        _compute_step(gains, misses, cameras, step)
        if _worst(slopes, misses, step, cameras) <= radius * radius:
            if count == len(positions):
                return count
            for p in range(3):
                positions[count, p] = start[p] + step[p]
            for c in range(cameras):
                hits[count, c] = chosen[c]
                for a in range(2):
                    bend = (
                        slopes[c, a, 0] * step[0]
                        + slopes[c, a, 1] * step[1]
                        + slopes[c, a, 2] * step[2]
                    )
                    errors[count, c, a] = misses[c, a] - bend
            count += 1
    return count


@numba.njit(cache=True)
def _worst(slopes: Any, misses: Any, step: Any, cameras: int) -> float:
    """Compute the largest squared miss of a camera at a position after a step."""
    worst = 0.0
    for c in range(cameras):
        square = 0.0
        for a in range(2):
            off = (
                misses[c, a]
                - slopes[c, a, 0] * step[0]
                - slopes[c, a, 1] * step[1]
                - slopes[c, a, 2] * step[2]
            )
            square += off * off
        worst = max(worst, square)
    return worst


@numba.njit(cache=True)
def pair_up(peaks: Any, pixels: Any, radius: float, out: Any) -> int:
    """Fill in pairs (pixel, peak) within a radius of each other; return how many.

    Stops when the arrays are full.
    """
    found, count = np.zeros(len(peaks.pixels), dtype=np.int64), 0
    for n in range(len(pixels)):
        for k in range(find_near(peaks, pixels[n], radius, found)):
            if count == len(out):
                return count
            out[count, 0], out[count, 1] = n, found[k]
            count += 1
    return count
