"""Particles of one frame by triangulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.algorithms.particles.triangulation import Candidates, find_candidates, select_best
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    fit_volume_polynomials,
    points_in_mm,
)
from sabench.images.brightness import background_noise
from sabench.images.peaks import Peaks, find_peaks
from sabench.utils.arrays import F32, F64

_MARGIN = 1.0  # voxels around the grid's centres in which particles are looked for


@dataclass(frozen=True)
class TriangulationSettings:
    """Settings of the search for particle images and of their agreement.

    Attributes
    ----------
    floor : smallest peak that counts as a particle image, over a bright particle's.
    noise : the same in standard deviations of the image's background; the larger one holds.
    reach_px : largest distance of a particle image from where its camera sees the particle.
    """

    floor: float = 0.05
    noise: float = 5.0
    reach_px: float = 0.8


def fit_cameras(case: Observation) -> VolumePolynomials:
    """Fit the cameras by polynomials over the grid and a margin."""
    low, voxel = np.asarray(case.grid.low_mm), np.asarray(case.grid.voxel_mm)
    high = low + voxel * (np.asarray(case.grid.shape[::-1]) - 1)
    return fit_volume_polynomials(case.cameras, low - _MARGIN * voxel, high + _MARGIN * voxel)


def triangulate_particles(
    case: Observation, maps: VolumePolynomials, settings: TriangulationSettings
) -> FoundParticles:
    """Triangulate the particles that particle images agree on, each image used once."""
    images, covered = case.normalised_images(), case.repaired.flaws.covered
    peaks = _find_peaks(images, settings)
    every = find_candidates(maps, peaks, settings.reach_px, covered)
    kept = select_best(every, peaks)
    found = Candidates(every.position[kept], every.hit[kept], every.error_px[kept])
    brightness = _peak_values(found, peaks, images).mean(axis=1)
    return FoundParticles(points_in_mm(maps, found.position), brightness)


def _find_peaks(images: F32, settings: TriangulationSettings) -> tuple[Peaks, ...]:
    """Find particle images above the background of every camera."""
    return tuple(
        find_peaks(image, max(settings.floor, settings.noise * background_noise(image)))
        for image in images
    )


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
