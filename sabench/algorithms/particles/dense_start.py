"""Start of tracks in images that no single frame can explain.

Where images overlap too much, many particles of a frame are ghosts, and as many are missing. What
is seen in several frames and moves as the flow does is real. What these particles leave of the
images is searched again, in each of the first frames, until no more of them are found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.algorithms.particles.window_tracks import Finds, confirm_tracks
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64

WINDOW = 6  # frames that are searched together
_PASSES = 4  # the most
_GROWTH = 1.1  # of the number of confirmed particles in a pass: after less comes the last pass
_ERROR_PX = 0.25  # of positions where images overlap, far more than they claim
_NEIGHBOURS = 8
_ALIKE = 0.4  # of the distance between neighbours: right links differ by less from those around
_SOLVED = 0.85  # of links: as many are right if few particles are ghosts


def are_mostly_wrong(position: F64, shift: F64) -> bool:
    """Find out whether too few links differ little from those around them.

    Parameters
    ----------
    position, shift : (n, 3) where each link begins and the displacement, in one unit.
    """
    if len(position) <= _NEIGHBOURS:
        return False
    distance, near = cKDTree(position).query(position, range(2, _NEIGHBOURS + 2))
    apart = np.linalg.norm(shift - np.median(shift[near], axis=1), axis=1)
    alike = apart < _ALIKE * np.median(distance[:, 0])
    return bool(alike.mean() < _SOLVED)


def search_window(
    cases: Sequence[Observation],
    times_s: Sequence[float],
    maps: VolumePolynomials,
    settings: BayesianIprSettings,
    alone: Sequence[ParticleSearch],
) -> list[ParticleSearch]:
    """Search the first frames again, with what several frames show.

    Parameters
    ----------
    cases, times_s : frames, at least as many as confirm a track.
    alone : the first of them as they were searched without others; returned if any frame shows too
        little.
    """
    searches: list[ParticleSearch | None] = list(alone)
    searches += [search_frame(case, maps, settings) for case in cases[len(alone) :]]
    confirmed = 0
    for number in range(_PASSES):
        found = [search.found() for search in searches if search is not None]
        if len(found) < len(cases) or min(len(one.position_mm) for one in found) <= _NEIGHBOURS:
            return list(alone)
        finds = [_finds(one, time, maps) for one, time in zip(found, times_s, strict=True)]
        known = confirm_tracks(finds, _spacing(found, maps))
        before, confirmed = confirmed, sum(len(one.position) for one in known)
        if not confirmed:
            return list(alone)
        last = number == _PASSES - 1 or confirmed < _GROWTH * before
        few = len(alone) if last else len(cases)
        searches = [
            search_frame(case, maps, settings, sure)
            for case, sure in zip(cases[:few], known[:few], strict=True)
        ]
        if last:
            break
    first = [search for search in searches if search is not None]
    return first if len(first) == len(alone) else list(alone)


def _spacing(found: Sequence[FoundParticles], maps: VolumePolynomials) -> float:
    """Compute the edge of the cube that holds one particle on average, mm."""
    count = np.mean([len(one.position_mm) for one in found])
    return float((np.prod(2.0 * maps.half_mm) / count) ** (1.0 / 3.0))


def _finds(found: FoundParticles, time: float, maps: VolumePolynomials) -> Finds:
    """Write down what a frame shows, with errors as large as where images overlap."""
    variance = np.asarray(found.covariance_mm2)[:, [0, 1, 2], [0, 1, 2]]
    usual = np.median(variance, axis=0)
    usual *= (_ERROR_PX * pixel_mm(maps)) ** 2 / usual.min()
    light = np.asarray(found.light)
    return Finds(time, found.position_mm, np.broadcast_to(usual, variance.shape), light)
