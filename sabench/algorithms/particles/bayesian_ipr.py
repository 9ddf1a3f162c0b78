"""Particles of one frame as the most probable explanation of the images.

Iterative particle reconstruction (B. Wieneke, Meas. Sci. Technol. 24, 024008, 2013) with a
probability in place of its thresholds. A particle has a position, light with a prior that is
learned from the images, and a penalty. First all candidates share the light, and the darkest go,
slowly. Then particles that gain less than their penalty go, others are found in what is left, and
pairs that look like one are split. Widths, light, noise and shifts of the cameras come from the
images.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from sabench.algorithms.particles.candidate_search import (
    rig_axes,
    turn_maps,
    turn_to_world,
    volume_shares,
)
from sabench.algorithms.particles.learned_model import (
    align_cameras,
    learn_light,
    learn_widths,
    weigh_pixels,
)
from sabench.algorithms.particles.obstacles import (
    are_doubtful,
    find_dark_views,
    find_partly_hidden,
    keep_hidden,
    warn_of_tilt,
    without_wrong_cameras,
)
from sabench.algorithms.particles.particle_search import ParticleSearch, joined, no_particles
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.images.background import ClearImages, clear_images
from sabench.images.widths import measure_images
from sabench.utils.arrays import F64, Bool
from sabench.utils.threads import Deadline

_FEWEST = 3  # cameras that must show particles
_ANY_LIGHT = 2.0  # scatter of the common logarithm while candidates share the light: no prior
_BETWEEN = 0.1  # scatter between cameras meanwhile
# where images overlap, they are narrower than measured by this share, until widths are learned:
# wider ones take the light of neighbours that are not found yet
_NARROWER = 0.05
_FEW_CAMERAS = 4  # that need all of the widening
_FIRST_FLOOR = 0.35  # of the first candidates' mean light, over a typical particle's
_DARKEST = (0.05, 0.1, 0.2, 0.3, 0.4, 0.45)  # light below which candidates go, over the median
_REAL = 0.3  # of a typical particle's light: what counts for that median
FLOORS = (0.2, 0.06)  # of the candidates of the first and the last later round
_FEWER = 0.998  # of the candidates: more that are left share the light as before
_STEPS = 3  # rounds from the first floor to the last
_GROWTH = 1.02  # of the number of particles in a round: less is the end
_UNEXPLAINED = 0.015  # of the light: more that remains has a reason
_NOTABLE = 0.001  # of the particles: fewer that are added are not worth another round
_FLATTER = 0.9  # of squares left, where images are flat (0.4 to 0.8); by chance few look so (0.97)
CAPS = (0.3, 0.05)  # largest error of the model, over a typical peak, first and last


@dataclass(frozen=True)
class BayesianIprSettings:
    """Settings of the search.

    Attributes
    ----------
    rounds : the most of search and removal, after the first.
    splits : the most rounds of splits, search and removal after those.
    fits : the most times that all particles are fitted at each step; it ends when they are settled.
    widening : of the particles' images while candidates share the light, over their width, with
        four cameras; less with more.
    budget_s : seconds after which a frame's search ends with the particles so far; None is no end.
    """

    rounds: int = 8
    splits: int = 3
    fits: int = 8
    widening: float = 1.3
    budget_s: float | None = None


def reconstruct_most_probable(
    case: Observation, maps: VolumePolynomials, settings: BayesianIprSettings
) -> FoundParticles:
    """Reconstruct the particles that make the images most probable."""
    axes = rig_axes(maps)
    search = search_frame(case, turn_maps(maps, axes), settings)
    if search is None:
        return no_particles(len(case.cameras))
    parts = find_partly_hidden(search) if search.unexplained() > _UNEXPLAINED else []
    found = reduce(joined, (one.found() for one in (search, *parts)))
    return turn_to_world(found, axes)


def dark_images(case: Observation) -> ClearImages:
    """Return repaired images less background, flaws, and saturated pixels."""
    good = case.repaired
    light = good.images.astype(np.float32) - np.float32(case.black_dn)
    return ClearImages(*clear_images(light, good.flaws), good.images >= case.white_dn)


class Known(NamedTuple):
    """Particles taken for real: positions (n, 3) mm, light (n, all cameras)."""

    position: F64
    light: F64


def search_frame(
    case: Observation,
    maps: VolumePolynomials,
    settings: BayesianIprSettings,
    known: Known | None = None,
) -> ParticleSearch | None:
    """Search for a frame's particles; None if too few cameras show any.

    The first candidates share the light that known particles leave. Areas in which something hides
    particles from a camera do not count. Cameras that contradict the others are left out, with a
    warning.
    """
    frame = _Frame(dark_images(case), maps, settings, Deadline(settings.budget_s), known)
    search = _find_visible(frame, np.zeros(len(case.cameras), dtype=np.bool_))
    if search is None:
        return None
    if not frame.deadline.over:
        names = [camera.name for camera in case.cameras]
        search = without_wrong_cameras(search, names, partial(_find_visible, frame))
        warn_of_tilt(search, names)
        if search.flat.any():
            _flatten(search)
    for _ in range(settings.splits):
        if frame.deadline.over:
            break
        weigh_pixels(search, CAPS[1])
        if split_and_find(search) < _NOTABLE * len(search.position):
            break
    weigh_pixels(search, CAPS[1])
    search.refine(2 * settings.fits)
    return search


def _flatten(search: ParticleSearch) -> None:
    """Take images for as flat as they were measured, where less of them is left then.

    All particles are tried again: those that are halves of one whose images were taken for
    Gaussians gain nothing now.
    """
    plain, before = search.shapes.copy(), search.squares_left()
    search.flatten()
    search.refine(search.fits)
    chance = search.squares_left() > _FLATTER * before
    if chance.any():
        search.set_shapes(np.where(chance[:, None, None], plain, search.shapes))
        search.refine(search.fits)
    if chance.all():
        return
    weigh_pixels(search, CAPS[1])
    learn_widths(search)
    search.sure[:] = False
    search.remove(lone=True)


class _Frame(NamedTuple):
    """A frame's images, and how they are searched."""

    clear: ClearImages
    maps: VolumePolynomials
    settings: BayesianIprSettings
    deadline: Deadline
    known: Known | None


def _find_visible(frame: _Frame, wrong: Bool) -> ParticleSearch | None:
    """Find most particles without the cameras (all cameras,) that are wrong.

    A dark area does not count if particles that are found without it should be seen there.
    """
    search = _find_most(frame, wrong)
    if search is None or frame.deadline.over:
        return search
    shares = volume_shares(frame.maps, frame.clear.images.shape[1:])
    dark = find_dark_views(search, frame.clear, shares)
    if search.unexplained() <= _UNEXPLAINED and dark.any() and not are_doubtful(search, dark):
        return search
    while dark.any():
        without = _find_most(frame, wrong, dark)
        if without is None or frame.deadline.over:
            break
        hidden = keep_hidden(without, dark)
        if (hidden == dark).all():
            return without
        dark = hidden
    return search


def _find_most(frame: _Frame, wrong: Bool, hidden: Bool | None = None) -> ParticleSearch | None:
    """Find all particles but those that look like one with others.

    Areas (camera, row, column) that are hidden do not count.
    """
    clear, maps, settings, deadline, known = frame
    unknown = clear.flaws.unknown if hidden is None else clear.flaws.unknown | hidden
    statistics = measure_images(clear.images.astype(np.float64), ~unknown)
    statistics = replace(statistics, shown=statistics.shown & ~wrong)
    if statistics.shown.sum() < _FEWEST:
        return None
    search = ParticleSearch(clear, maps, statistics, settings.fits)
    if hidden is not None:
        search.hide(hidden)
    search.deadline = deadline
    if known is not None:
        _put_known(search, known)
    _share_the_light(search, settings)
    for number in range(settings.rounds):
        if deadline.over:
            break
        before, along = len(search.position), min((number + 1) / _STEPS, 1.0)
        search.find(FLOORS[0] * (FLOORS[1] / FLOORS[0]) ** along)
        search.refine(settings.fits)
        weigh_pixels(search, CAPS[0] * (CAPS[1] / CAPS[0]) ** along)
        search.remove(lone=number > 0)
        learn_light(search)
        align_cameras(search)
        if along == 1.0 and len(search.position) < _GROWTH * before:
            break
    return search


def _put_known(search: ParticleSearch, known: Known) -> None:
    """Put in the known particles that are in the box."""
    place = (known.position - search.maps.middle_mm) / search.maps.half_mm
    inside = (np.abs(place) <= 1.0).all(axis=1)
    light = known.light[inside][:, search.shown]
    light = np.where(light > 0.0, light, search.typical)
    search.put(place[inside], light, np.full(len(light), -1))


def split_and_find(search: ParticleSearch) -> int:
    """Try to split particles, add what is left, and remove what gains too little.

    Returns how many were added.
    """
    before = len(search.position)
    search.split()
    search.refine(search.fits)
    search.find(FLOORS[1])
    more = len(search.position) - before
    search.refine(search.fits)
    weigh_pixels(search, CAPS[1])
    search.remove(lone=True)
    learn_light(search)
    learn_widths(search)
    return more


def _share_the_light(search: ParticleSearch, settings: BayesianIprSettings) -> None:
    """Let the first candidates share the light, and drop the darkest, slowly.

    Particles that are there already keep theirs. Meanwhile saturated pixels have no more light than
    they show, or candidates would not share it. Images are wider than they are, which keeps
    candidates together whose images meet by chance. In many cameras few do, but then two particles
    whose images are wide become one.
    """
    narrow, saturated, images = search.sigma, search.saturated, search.images.copy()
    known = search.particles()
    search.images[:] = search.left
    search.select(np.zeros(len(known.position), dtype=np.bool_))
    search.saturated = np.zeros_like(saturated)
    few = min(_FEW_CAMERAS / len(search.typical), 1.0) ** 2
    search.set_width((1.0 + few * (settings.widening - 1.0)) * narrow)
    search.reset_covariance(_BETWEEN, _ANY_LIGHT)
    weigh_pixels(search, CAPS[0])
    search.find(_FIRST_FLOOR)
    search.refine(settings.fits)
    before = np.inf  # the first time
    for level in _DARKEST:
        if len(search.position) < before:
            weigh_pixels(search, CAPS[0])
            search.refine(settings.fits)
        common = search.common_light()
        real, before = common[common > _REAL], _FEWER * len(common)
        search.keep(common >= level * (np.median(real) if len(real) else 1.0))
    search.saturated = saturated
    search.reset_covariance()
    search.set_width((1.0 - _NARROWER * min(search.overlap(), 1.0)) * narrow)
    search.refine(settings.fits)
    search.images[:] = images
    search.subtract_all()
    if len(known.position):
        search.put(known.position, known.light, np.full(len(known.position), -1))
        search.refine(settings.fits)
    learn_light(search)
