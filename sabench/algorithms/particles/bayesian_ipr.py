"""Particles of one frame as the most probable explanation of the images.

Iterative particle reconstruction (B. Wieneke, Meas. Sci. Technol. 24, 024008, 2013) with a
probability in place of its thresholds. A particle has a place, light with a prior that is learned
from the images, and a price. First all candidates share the light, and the darkest go, slowly. Then
particles that do not earn their price go, others are found in what is left, and pairs that look
like one are split. Widths, light, noise and shifts of the cameras come from the images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.algorithms.particles.image_statistics import measure_images
from sabench.algorithms.particles.particle_search import ParticleSearch, no_particles
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.images.flaws import Flaws
from sabench.utils.arrays import F32

_FEWEST = 3  # cameras that must show particles
_ANY_LIGHT = 2.0  # scatter of the common logarithm while candidates share the light: no prior
_BETWEEN = 0.1  # scatter between cameras meanwhile
_FIRST_FLOOR = 0.35  # of the first candidates' mean light, over a typical particle's
_DARKEST = (0.05, 0.1, 0.2, 0.3, 0.4, 0.45)  # light below which candidates go, over the median
_REAL = 0.3  # of a typical particle's light: what counts for that median
FLOORS = (0.2, 0.06)  # of the candidates of the first and the last later round
CAPS = (0.3, 0.05)  # largest error of the model, over a typical peak, first and last


@dataclass(frozen=True)
class BayesianIprSettings:
    """Settings of the search.

    Attributes
    ----------
    rounds : of search and removal, after the first.
    splits : rounds of splits, search and removal after those.
    fits : times that all particles are fitted at each step.
    widening : of the particles' images while candidates share the light, over their width: it
        brings particles together whose images meet by chance.
    """

    rounds: int = 3
    splits: int = 3
    fits: int = 2
    widening: float = 1.3


def reconstruct_most_probable(
    case: Observation, maps: VolumePolynomials, settings: BayesianIprSettings
) -> FoundParticles:
    """Reconstruct the particles that make the images most probable."""
    search = search_frame(case, maps, settings)
    return search.found() if search else no_particles(len(case.cameras))


def images_less_black(case: Observation) -> tuple[F32, Flaws]:
    """Return the repaired images (camera, row, column) less black, and their flaws."""
    good = case.repaired
    return good.images.astype(np.float32) - np.float32(case.black_dn), good.flaws


def search_frame(
    case: Observation, maps: VolumePolynomials, settings: BayesianIprSettings
) -> ParticleSearch | None:
    """Search for a frame's particles; None if too few cameras show any."""
    images, flaws = images_less_black(case)
    statistics = measure_images(images.astype(np.float64), ~flaws.unknown)
    if statistics.shown.sum() < _FEWEST:
        return None
    search = ParticleSearch(images, flaws, maps, statistics, settings.fits)
    _share_the_light(search, settings)
    for number in range(settings.rounds):
        along = (number + 1) / settings.rounds
        search.find(FLOORS[0] * (FLOORS[1] / FLOORS[0]) ** along)
        search.refine(settings.fits)
        search.weigh(CAPS[0] * (CAPS[1] / CAPS[0]) ** along)
        search.remove(lone=number > 0)
        search.learn()
        search.align()
    for _ in range(settings.splits):
        search.weigh(CAPS[1])
        before = len(search.position)
        split_and_find(search)
        if len(search.position) == before:
            break
    search.weigh(CAPS[1])
    search.refine(2 * settings.fits)
    return search


def split_and_find(search: ParticleSearch) -> None:
    """Try misfits as two, add what is left, and remove what does not earn its price."""
    search.split()
    search.refine(search.fits)
    search.find(FLOORS[1])
    search.refine(search.fits)
    search.weigh(CAPS[1])
    search.remove(lone=True)
    search.learn()
    search.learn_widths()


def _share_the_light(search: ParticleSearch, settings: BayesianIprSettings) -> None:
    """Let the first candidates share the light, and drop the darkest, slowly."""
    narrow = search.sigma
    search.set_width(settings.widening * narrow)
    search.reset_covariance(_BETWEEN, _ANY_LIGHT)
    search.weigh(CAPS[0])
    search.find(_FIRST_FLOOR)
    search.refine(settings.fits)
    for level in _DARKEST:
        search.weigh(CAPS[0])
        search.refine(settings.fits)
        common = search.common_light()
        real = common[common > _REAL]
        search.keep(common >= level * (np.median(real) if len(real) else 1.0))
    search.reset_covariance()
    search.set_width(narrow)
    search.refine(settings.fits)
    search.learn()
