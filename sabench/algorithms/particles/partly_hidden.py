"""Particles that something hides from some of the cameras.

A body hides what is behind it and shows what is in front, so that no area of an image tells which
particles a camera misses. They are searched for in the light that the others leave: in all cameras
but one, in all but two, and so on. Of larger sets of cameras, those are tried that contain one
which hides particles, the most promising first.
"""

from __future__ import annotations

import copy

import numpy as np

from sabench.algorithms.particles.all_particles import earnings
from sabench.algorithms.particles.image_model import without_margins
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.utils.arrays import F64

_FEWEST = 3  # cameras that must show a particle
_HIDDEN = 0.1  # of the particles: expected to be hidden from one camera, and again from each more
_SOME = 3e-4  # of the particles: fewer that a set of cameras hides are no reason to try larger ones
_DEEPEST, _TRIED = 4, 100  # cameras that may be blind, and sets of each number that are tried
_FLOORS = (0.35, 0.2)  # of candidates' light over a typical particle's
_DENIED = -10.0  # cost that a particle's light saves in a camera that does not see it

Cameras = tuple[int, ...]


def find_partly_hidden(search: ParticleSearch) -> list[ParticleSearch]:
    """Find particles that up to a third of the cameras, rounded, do not see.

    They are found in what a search leaves of the images, or among its particles, and subtracted
    from its images. Returns one search for the particles that the same cameras see.
    """
    found: list[ParticleSearch] = []
    hidden: dict[Cameras, int] = {(): 1}  # how many particles sets of cameras hide
    number = len(search.typical)
    most = min((number + 1) // 3, number - _FEWEST, _DEEPEST)
    for _ in range(most):
        before, hidden = hidden, {}
        for blind in _promising(number, before):
            if search.deadline.over:
                break
            part = _without(search, blind)
            if _find(part):
                found.append(part)
                _subtract(search, part)
            if len(part.position) > _SOME * search.number:
                hidden[blind] = len(part.position)
    for blind, (position, light) in _take_denied(search, most).items():
        part = _without(search, blind)
        part.put(position, np.delete(light, blind, axis=1), np.full(len(light), -1))
        part.refine(part.fits)
        part.remove(lone=True)
        if len(part.position):
            found.append(part)
            _subtract(search, part)
    search.refine(search.fits)
    return found


def _promising(number: int, before: dict[Cameras, int]) -> list[Cameras]:
    """List sets of cameras that contain one which hides particles.

    Those come first whose smaller sets hide most; no more than can be tried.
    """
    promise: dict[Cameras, int] = {}
    for smaller, many in before.items():
        for camera in set(range(number)).difference(smaller):
            blind = tuple(sorted((*smaller, camera)))
            promise[blind] = promise.get(blind, 0) + many
    return sorted(promise, key=lambda blind: (-promise[blind], blind))[:_TRIED]


def _take_denied(search: ParticleSearch, most: int) -> dict[Cameras, tuple[F64, F64]]:
    """Take out particles that up to `most` cameras deny.

    Returns positions (n, 3) and light (n, camera) of those that the same cameras deny.
    """
    denied = earnings(search.model(), search.widest, search.particles()) < _DENIED
    count = denied.sum(axis=1)
    rows: dict[Cameras, list[int]] = {}
    for n in np.flatnonzero((count > 0) & (count <= most)).tolist():
        rows.setdefault(tuple(np.flatnonzero(denied[n]).tolist()), []).append(n)
    out = {blind: (search.position[own], search.light[own]) for blind, own in rows.items()}
    search.keep((count == 0) | (count > most))
    return out


def _without(search: ParticleSearch, blind: Cameras) -> ParticleSearch:
    """Make a search without particles of what is left in all cameras but some."""
    part = copy.copy(search)
    seeing = np.setdiff1d(np.arange(len(search.typical)), blind)
    part.shown = np.zeros_like(search.shown)
    part.shown[np.flatnonzero(search.shown)[seeing]] = True
    part.maps = search.maps._replace(coefficients=search.maps.coefficients[seeing])
    part.number = search.number * _HIDDEN ** len(blind)
    part.covariance = search.covariance[np.ix_(seeing, seeing)]
    for name in (
        *("noise", "typical", "variance", "known", "covered", "saturated"),
        *("tilt", "flat", "shapes", "first_shapes", "framed_left"),
    ):
        setattr(part, name, getattr(search, name)[seeing])
    part.framed = part.framed_left.copy()
    part.images, part.left = without_margins(part.framed), without_margins(part.framed_left)
    part.light = search.light[:, seeing]
    part.select(np.zeros(len(search.position), dtype=np.bool_))
    return part


def _find(part: ParticleSearch) -> bool:
    """Find particles, and tell whether there are any."""
    for floor in _FLOORS:
        part.find(floor)
        part.refine(part.fits)
        part.remove(lone=True)
        if not len(part.position):
            return False
    part.refine(part.fits)
    return True


def _subtract(search: ParticleSearch, part: ParticleSearch) -> None:
    """Take the light of particles out of the images of another search."""
    seeing = np.flatnonzero(part.shown[search.shown])
    search.framed[seeing] -= part.framed - part.framed_left
    search.framed_left[seeing] = part.framed_left
