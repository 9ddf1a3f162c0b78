"""Errors of a reconstructed volume: quality factor, particles, intensities.

The volume is compared with the synthesised field E_s. The intensity of a blob is a sum over all
voxels that lead up to its peak, and does not depend on its shape.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sabench.api import Reconstruction
from sabench.api.truth import Particles, ParticleView
from sabench.geometry.grid import Grid, check_volume, synthesise
from sabench.metrics import particle_detection as detection
from sabench.metrics.quality_factor import quality
from sabench.utils import memory
from sabench.utils.arrays import F32, F64, I64, U8, Bool
from sabench.utils.compiled import numba


def true_field(grid: Grid, particles: Particles, views: Sequence[ParticleView]) -> F32:
    """Synthesise the field E_s (z, y, x) of a frame's particles.

    Every particle, visible or not, is a Gaussian sphere in mm. Its peak is its `brightness`, its
    standard deviation the median size of the particle images, converted from pixels to mm with the
    grid's spacing along x.

    Parameters
    ----------
    views : what each camera receives of the same particles.

    Raises InputError: the field does not fit into memory.
    """
    check_volume(grid)
    if not len(particles):
        return np.zeros(grid.shape, dtype=np.float32)
    sigma_px = float(np.nanmedian(np.concatenate([view.sigma_px for view in views])))
    return synthesise(grid, particles.position_mm, brightness(views), sigma_px * grid.voxel_mm[0])


def brightness(views: Sequence[ParticleView]) -> F64:
    """Average each particle's relative photon count over cameras that see its light.

    The count of a camera is relative to the mean of all particles illuminated in it. Returns
    (particle,); 0 for a particle that is illuminated in no camera.
    """
    photons = np.stack([view.photons for view in views])
    illuminated = photons > 0.0
    typical = photons.sum(axis=1) / np.maximum(illuminated.sum(axis=1), 1)
    relative = photons / np.maximum(typical, 1e-300)[:, None]
    return np.asarray(relative.sum(axis=0) / np.maximum(illuminated.sum(axis=0), 1))


FACE = 4.0  # voxels from the volume's faces, which cut blobs
APART = 3.0  # voxels along some axis between particles with separate blobs
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
    step = _find_steps(volume)
    summits = np.flatnonzero((step == _HERE) & (volume > 0.0))
    light = _climb(volume, step, summits)
    places = np.stack(np.unravel_index(summits, volume.shape)[::-1], axis=1).astype(np.float64)
    distance, nearest = cKDTree(peaks).query(places, p=np.inf)
    near = distance < detection.CHALLENGE_RADIUS
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
    scored = scored_truth & _alone(truth, brightness > 0.0, volume.shape)
    if not scored.any():
        return None
    a, b = detection.challenge_pairs(estimate, truth)
    light = np.zeros(len(truth))
    light[b] = blob_intensities(volume, estimate)[a]
    estimated, true = light[scored], brightness[scored]
    norm, true_norm = np.linalg.norm(estimated), np.linalg.norm(true)
    cosine = np.vdot(estimated / norm, true / true_norm) if norm > 0.0 else 0.0
    return float(np.sqrt(max(0.0, 1.0 - cosine**2)))


def _alone(truth: F64, lit: Bool, shape: tuple[int, ...]) -> Bool:
    """Mark the lit particles (n, 3) with blobs that no face or other blob cuts."""
    last = np.asarray(shape[::-1]) - 1.0
    alone = np.asarray(lit & ((truth >= FACE) & (truth <= last - FACE)).all(axis=1))
    distance, _ = cKDTree(truth[lit]).query(truth[alone], k=2, p=np.inf)
    alone[alone] = distance[:, 1] >= APART
    return alone


@numba.njit(cache=True)
def _find_steps(volume: Any) -> Any:
    """Find the number of each voxel's first brightest neighbour, 13 for itself."""
    step, (depth, rows, columns) = np.empty(volume.shape, np.uint8), volume.shape
    for z, y, x in np.ndindex(volume.shape):
        best, number = volume[z, y, x], _HERE
        for i in range(max(z - 1, 0), min(z + 2, depth)):
            for j in range(max(y - 1, 0), min(y + 2, rows)):
                for k in range(max(x - 1, 0), min(x + 2, columns)):
                    if volume[i, j, k] > best:
                        best, number = volume[i, j, k], ((i - z) * 3 + j - y) * 3 + k - x + _HERE
        step[z, y, x] = number
    return step


def _climb(volume: F32, step: U8, summits: I64) -> F64:
    """Add up the intensity of all voxels that lead to each summit."""
    _, rows, columns = volume.shape
    z, y, x = np.unravel_index(np.arange(27), (3, 3, 3))
    away = ((z - 1) * rows + y - 1) * columns + x - 1
    light, flat = np.zeros(len(summits)), step.reshape(-1)
    for number, plane in enumerate(volume):
        lit = np.flatnonzero(plane > 0.0)
        at = number * plane.size + lit
        moving = np.arange(len(at))
        while len(moving):
            at[moving] += away[flat[at[moving]]]
            moving = moving[flat[at[moving]] != _HERE]
        np.add.at(light, np.searchsorted(summits, at), plane.reshape(-1)[lit].astype(np.float64))
    return light


_DETECTION = ("true_percent", "ghost_percent", "precision", "recall", "rms_px")


def score_frame(
    grid: Grid, particles: Particles, views: Sequence[ParticleView], estimate: Reconstruction
) -> dict[str, float | None]:
    """Score one frame's estimate against its true particles."""
    truth, peaks = grid.to_voxels(particles.position_mm), _peaks(grid, estimate)
    scored = grid.in_scored(truth)
    # an estimate that lists particles replaces both ways of detection
    detected = detection.detect(estimate.volume) if estimate.particles_mm is None else peaks
    counts: dict[str, float | None] = {}
    f1: dict[str, float | None] = {}
    for prefix, points in (("", detected), ("peak_", peaks)):
        arguments = points, truth, grid.in_scored(points), scored
        thesis = detection.count_thesis(*arguments)
        challenge = detection.count_challenge(*arguments)
        figures = thesis.true_percent, thesis.ghost_percent, challenge.precision
        for key, value in zip(_DETECTION, (*figures, challenge.recall, challenge.rms), strict=True):
            counts[prefix + key] = value
        f1[prefix] = challenge.f1
    light = intensity_error(estimate.volume, peaks, truth, brightness(views), scored)
    memory.trim()
    q = quality(estimate.volume[grid.scored], true_field(grid, particles, views)[grid.scored])
    return {"q": q, "peak_f1": f1["peak_"], "intensity_error": light, **counts}


def peak_f1_over_distance(grid: Grid, particles: Particles, estimate: Reconstruction) -> F64:
    """Compute peak F1 as a curve over the matching distances of `MATCHING_DISTANCES`."""
    truth, peaks = grid.to_voxels(particles.position_mm), _peaks(grid, estimate)
    scored = grid.in_scored(peaks), grid.in_scored(truth)
    return detection.f1_over_distance(peaks, truth, *scored, detection.MATCHING_DISTANCES)


def _peaks(grid: Grid, estimate: Reconstruction) -> F64:
    if estimate.particles_mm is None:
        return detection.detect_peaks(estimate.volume)
    return grid.to_voxels(estimate.particles_mm)
