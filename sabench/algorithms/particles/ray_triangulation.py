"""Particles of one frame by triangulation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.particles.peak_detection import detect_in_cameras, heights, heights_of
from sabench.algorithms.particles.time_budget import Deadline
from sabench.algorithms.particles.triangulation import (
    count_by_chance,
    find_candidates,
    select_best,
    select_rows,
)
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    fit_volume_polynomials,
    points_in_mm,
)
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.peaks import Peaks, keep_peaks
from sabench.utils.arrays import F32, I64

_MARGIN = 1.0  # voxels around the grid's centres in which particles are looked for
_MOST_BY_CHANCE = 5.0  # sets of particle images with each one: beyond, nearly all are ghosts


@dataclass(frozen=True)
class TriangulationSettings:
    """Settings of the search for particle images and of their agreement.

    Attributes
    ----------
    floor : smallest peak that counts as a particle image, over a bright particle's.
    false_alarms : probability that noise makes a particle image of a pixel; the larger of both
        thresholds holds.
    reach_px : largest distance of a particle image from where its camera sees the particle.
    budget_s : seconds for a frame, after which the particles so far are the result; None is no end.
    """

    floor: float = 0.05
    false_alarms: float = FALSE_ALARMS
    reach_px: float = 0.8
    budget_s: float | None = None


def fit_cameras(case: Observation) -> VolumePolynomials:
    """Fit the cameras by polynomials over the grid and a margin."""
    low, voxel = np.asarray(case.grid.low_mm), np.asarray(case.grid.voxel_mm)
    high = low + voxel * (np.asarray(case.grid.shape[::-1]) - 1)
    return fit_volume_polynomials(case.cameras, low - _MARGIN * voxel, high + _MARGIN * voxel)


def triangulate_particles(
    case: Observation, maps: VolumePolynomials, settings: TriangulationSettings
) -> FoundParticles:
    """Triangulate the particles that particle images agree on, each image used once.

    Bright images come first. A warning says where the time budget leaves some out, and where there
    are so many that most agree by chance: the brightest of them are used.
    """
    deadline = Deadline(settings.budget_s)
    images = case.normalised_images()
    peaks = detect_in_cameras(case, settings.floor, settings.false_alarms)
    peaks = _thin_out(case, maps, peaks, images, settings.reach_px)
    order = np.argsort(-heights(peaks[0], images[0]), kind="stable")
    every = find_candidates(
        maps, peaks, settings.reach_px, case.repaired.flaws.covered, order, deadline
    )
    if deadline.over:
        _warn(
            f"ray_triangulation: the time budget of {settings.budget_s:g} s a frame is spent: the "
            "result holds the particles found so far, the brightest ones first"
        )
    found = select_rows(every, select_best(every, peaks))
    brightness = heights_of(found.hit, peaks, images).mean(axis=1)
    return FoundParticles(points_in_mm(maps, found.position), brightness)


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
    kept = tuple(
        keep_peaks(own, _brightest(heights(own, image), share))
        for own, image in zip(peaks, images, strict=True)
    )
    counts = ", ".join(
        f"{len(few.pixels)} of {len(own.pixels)} in {camera.name}"
        for camera, few, own in zip(case.cameras, kept, peaks, strict=True)
    )
    _warn(
        f"ray_triangulation: expected at most {_MOST_BY_CHANCE:g} sets of particle images that "
        f"agree by chance with each one, got {chance:.0f}: the brightest images are used "
        f"({counts}); raise floor, or lower false_alarms or reach_px"
    )
    return kept


def _brightest(heights: F32, share: float) -> I64:
    """Select the numbers of the highest peaks, in their order."""
    count = int(share * len(heights))
    return np.sort(np.argsort(-heights, kind="stable")[:count])


def _warn(sentence: str) -> None:
    warnings.warn(sentence, stacklevel=2)
