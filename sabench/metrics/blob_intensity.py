"""Intensity of a volume's blobs, summed over all voxels that lead up to a peak.

It depends on how bright a blob is, not on its shape.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from scipy.spatial import cKDTree

from sabench.metrics.particle_detection import CHALLENGE_RADIUS, challenge_pairs
from sabench.utils.arrays import F32, F64, Bool

FACE = 4.0  # voxels from the volume's faces, which cut blobs
APART = 3.0  # voxels along some axis between particles whose blobs are told apart
_HERE = 13  # of the numbers of 27 neighbours


def blob_intensities(volume: F32, peaks: F64) -> F64:
    """Sum the intensity of the blob of each peak.

    From every voxel above zero, steps to the brightest of its 26 neighbours lead to a summit, which
    belongs to the nearest peak if that is less than 1 voxel away along every axis.

    Parameters
    ----------
    volume : (z, y, x).
    peaks : (n, 3) fractional voxel indices of x, y, z.
    """
    sums = np.zeros(len(peaks))
    if not len(peaks):
        return sums
    step = np.full(volume.shape, _HERE, dtype=np.uint8)
    _find_steps(volume, step)
    summits = np.flatnonzero((step == _HERE) & (volume > 0.0))
    light = np.zeros(len(summits))
    _climb(volume, step, summits, light)
    places = np.stack(np.unravel_index(summits, volume.shape)[::-1], axis=1).astype(np.float64)
    distance, nearest = cKDTree(peaks).query(places, p=np.inf)
    near = distance < CHALLENGE_RADIUS
    np.add.at(sums, nearest[near], light[near])
    return sums


def intensity_error(
    volume: F32, estimate: F64, truth: F64, brightness: F64, scored_truth: Bool
) -> float | None:
    """Compute the relative error of intensities; None without true particles.

    It is the root mean square difference between the intensities of matched peaks, after the scale
    that makes it smallest, and the brightness of all true particles, relative to the brightness's
    root mean square. Particles without a peak have the intensity 0.

    Parameters
    ----------
    estimate, truth : peaks (n, 3) and true particles (m, 3) in voxels, paired as by
        `count_challenge`.
    brightness, scored_truth : (m,) of the true particles, and which of them are in the scored part.
        Those within `FACE` of the volume's faces, or of `APART` of another one, are left out.
    """
    kept = scored_truth & _alone(truth, brightness > 0.0, volume.shape)
    if not kept.any():
        return None
    a, b = challenge_pairs(estimate, truth)
    light = np.zeros(len(truth))
    light[b] = blob_intensities(volume, estimate)[a]
    found, true = light[kept], brightness[kept]
    own, other = np.linalg.norm(found), np.linalg.norm(true)
    cosine = np.vdot(found / own, true / other) if own > 0.0 else 0.0
    return float(np.sqrt(max(0.0, 1.0 - cosine**2)))


def _alone(truth: F64, lit: Bool, shape: tuple[int, ...]) -> Bool:
    """Mark the lit particles (n, 3) whose blobs neither a face nor another one cuts."""
    last = np.asarray(shape[::-1]) - 1.0
    alone = np.asarray(lit & ((truth >= FACE) & (truth <= last - FACE)).all(axis=1))
    distance, _ = cKDTree(truth[lit]).query(truth[alone], k=2, p=np.inf)
    alone[alone] = distance[:, 1] >= APART
    return alone


@numba.njit(cache=True, parallel=True)
def _find_steps(volume: Any, step: Any) -> None:
    """Find the number of each voxel's brightest neighbour, 13 for itself."""
    planes, rows, columns = volume.shape
    for z in numba.prange(planes):
        for y in range(rows):
            for x in range(columns):
                if volume[z, y, x] > 0.0:
                    step[z, y, x] = _step(volume, z, y, x)


@numba.njit(cache=True)
def _step(volume: Any, z: int, y: int, x: int) -> int:
    best, number = volume[z, y, x], _HERE
    for c in range(max(z - 1, 0), min(z + 2, volume.shape[0])):
        for b in range(max(y - 1, 0), min(y + 2, volume.shape[1])):
            for a in range(max(x - 1, 0), min(x + 2, volume.shape[2])):
                if volume[c, b, a] > best:
                    best = volume[c, b, a]
                    number = 9 * (c - z + 1) + 3 * (b - y + 1) + a - x + 1
    return number


@numba.njit(cache=True)
def _climb(volume: Any, step: Any, summits: Any, light: Any) -> None:
    """Add each voxel's intensity to the light of its summit."""
    planes, rows, columns = volume.shape
    for z in range(planes):
        for y in range(rows):
            for x in range(columns):
                if volume[z, y, x] > 0.0:
                    c, b, a = z, y, x
                    while step[c, b, a] != _HERE:
                        number = int(step[c, b, a])
                        c, b, a = c + number // 9 - 1, b + number // 3 % 3 - 1, a + number % 3 - 1
                    summit = np.searchsorted(summits, (c * rows + b) * columns + a)
                    light[summit] += volume[z, y, x]
