"""Particles of one frame by triangulation.

Iterative reconstruction repeats the triangulation on the residual images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.refinement import (
    image_widths,
    in_mm,
    peak_brightness,
    refine_particles,
    subtract_images,
)
from sabench.algorithms.particles.triangulation import Candidates, find_candidates, select_best
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    fit_volume_polynomials,
    project_points,
)
from sabench.images.brightness import background_noise
from sabench.images.peaks import Peaks, find_peaks
from sabench.utils.arrays import F32, F64, Bool

_MARGIN = 1.0  # voxels around the grid's centres in which particles are looked for


@dataclass(frozen=True)
class IprSettings:
    """Settings of the search for particles.

    Attributes
    ----------
    floor : smallest peak that counts as a particle image, over a bright particle's.
    noise : the same in standard deviations of the image's background; the larger one holds.
    reach_px : largest distance of a particle image from where its camera sees the particle.
    rounds : of triangulation with all cameras, and then with one camera fewer, on what is left;
        each is led by the next camera.
    fits : rounds of fitting after each.
    faint : brightness in its second darkest camera, over the median particle's, below which a
        particle is a ghost.
    apart_px : distance of two particles' images in every camera below which they are one.
    """

    floor: float = 0.05
    noise: float = 5.0
    reach_px: float = 0.8
    rounds: tuple[int, int] = (4, 4)
    fits: int = 8
    faint: float = 0.15
    apart_px: float = 0.7


def fit_cameras(case: Observation) -> VolumePolynomials:
    """Fit the cameras by polynomials over the grid and a margin."""
    low, voxel = np.asarray(case.grid.low_mm), np.asarray(case.grid.voxel_mm)
    high = low + voxel * (np.asarray(case.grid.shape[::-1]) - 1)
    return fit_volume_polynomials(case.cameras, low - _MARGIN * voxel, high + _MARGIN * voxel)


def triangulate_particles(
    case: Observation, maps: VolumePolynomials, settings: IprSettings
) -> FoundParticles:
    """Triangulate the particles that particle images agree on, each image used once."""
    images, covered = case.normalised_images(), case.repaired.flaws.covered
    peaks = _find_peaks(images, settings)
    found = _select_unique(maps, peaks, settings, 0, 0, covered)
    return FoundParticles(
        in_mm(maps, found.position), _peak_values(found, peaks, images).mean(axis=1)
    )


def reconstruct_particles(
    case: Observation, maps: VolumePolynomials, settings: IprSettings
) -> FoundParticles:
    """Reconstruct the particles that explain the images.

    They are found and fitted again and again on the residual images.
    """
    images, flaws = case.normalised_images(), case.repaired.flaws
    unknown = flaws.unknown
    sigma = image_widths(images, [one.pixels for one in _find_peaks(images, settings)])
    left, positions, light = images.copy(), np.zeros((0, 3)), np.zeros((0, len(images)))
    full, reduced = settings.rounds
    for number in range(full + reduced):
        peaks = _find_peaks(left, settings)
        found = _select_unique(maps, peaks, settings, int(number >= full), number, flaws.covered)
        positions = np.concatenate([positions, found.position])
        light = np.concatenate([light, np.zeros((len(found.position), len(images)))])
        refine_particles(maps, sigma, left, unknown, positions, light, settings.fits)
        shown = _shown(maps, positions, flaws.covered)
        good = _real(maps, positions, np.where(shown, light, np.nan), settings)
        subtract_images(maps, sigma, left, positions[~good], light[~good])
        positions, light = positions[good], light[good]
    refine_particles(maps, sigma, left, unknown, positions, light, settings.fits)
    seen = np.where(_shown(maps, positions, flaws.covered), light, np.nan)
    return FoundParticles(in_mm(maps, positions), _mean_known(peak_brightness(seen, sigma)))


def _find_peaks(images: F32, settings: IprSettings) -> tuple[Peaks, ...]:
    """Find particle images above the background of every camera."""
    return tuple(
        find_peaks(image, max(settings.floor, settings.noise * background_noise(image)))
        for image in images
    )


def _select_unique(
    maps: VolumePolynomials,
    peaks: tuple[Peaks, ...],
    settings: IprSettings,
    missing: int,
    number: int,
    covered: Bool,
) -> Candidates:
    """Select candidates so that each particle image belongs to one.

    The cameras whose lines of sight are followed change from round to round.
    """
    first = number % len(peaks)
    order = (first, (first + 1) % len(peaks))
    found = find_candidates(maps, peaks, order, settings.reach_px, missing, covered)
    kept = select_best(found, peaks)
    return Candidates(found.position[kept], found.hit[kept], found.error_px[kept])


def _peak_values(found: Candidates, peaks: tuple[Peaks, ...], images: F32) -> F64:
    """Return the brightest pixels (n, camera) of candidates' particle images.

    0 where a camera shows none.
    """
    out = np.zeros(found.hit.shape)
    for camera, (one, image) in enumerate(zip(peaks, images, strict=True)):
        there = found.hit[:, camera] >= 0
        column, row = np.rint(one.pixels[found.hit[there, camera]]).astype(np.int64).T
        out[there, camera] = image[row, column]
    return out


def _shown(maps: VolumePolynomials, positions: F64, covered: Bool) -> Bool:
    """Mark (n, camera) where no reflection covers a particle's image."""
    shown = np.ones((len(positions), len(covered)), dtype=bool)
    for camera, area in enumerate(covered):
        column, row = np.rint(project_points(maps, camera, positions)).astype(np.int64).T
        inside = (row >= 0) & (row < area.shape[0]) & (column >= 0) & (column < area.shape[1])
        shown[inside, camera] = ~area[row[inside], column[inside]]
    return shown


def _mean_known(values: F64) -> F64:
    """Average rows (n, camera) over what is known; 0 where nothing is."""
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=1)
    return np.asarray(total / np.maximum(known.sum(axis=1), 1))


def _real(maps: VolumePolynomials, positions: F64, light: F64, settings: IprSettings) -> Bool:
    """Mark particles that are bright enough in enough cameras.

    Cameras whose light (n, camera) is NaN do not count. Duplicates of another particle are left
    out.
    """
    if not len(positions):
        return np.zeros(0, dtype=bool)
    unseen = np.isnan(light).all(axis=0)
    typical = np.maximum(np.nanmedian(np.where(unseen, 0.0, light), axis=0), 1e-12)
    second = np.sort(light / typical, axis=1)[:, min(1, light.shape[1] - 2)]
    good = np.asarray(second >= settings.faint)
    total = np.nansum(light, axis=1)
    radius = settings.apart_px * _mm_per_px(maps)
    for i, j in cKDTree(in_mm(maps, positions)).query_pairs(radius):
        if good[i] and good[j]:
            good[i if total[i] < total[j] else j] = False
    return good


def _mm_per_px(maps: VolumePolynomials) -> float:
    """Compute the size of a pixel in the middle of the box, along X."""
    ends = np.array([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    return float(
        0.02 * maps.half_mm[0] / np.linalg.norm(np.diff(project_points(maps, 0, ends), axis=0))
    )
