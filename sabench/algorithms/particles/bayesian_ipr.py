"""Particles of one frame as the most probable explanation of the images.

Iterative particle reconstruction (B. Wieneke, Meas. Sci. Technol. 24, 024008, 2013) with a
probability in place of its thresholds.

Model. Less black and background, camera c shows I_c(x) = sum_n L_nc g_c(x - P_c(X_n)) + noise.
P_c maps the position X_n of particle n to a pixel (`VolumePolynomials`). g_c is a Gaussian of two
widths and a tilt, or flatter, which change over the volume (`image_model`). The variance
v_c(x) of a pixel is a line over the model's light, at most a cap that falls from round to round,
and at least the sum of the variance of dark pixels, (3 % of the model)^2 and (a quarter of what is
left)^2. A saturated pixel has at least its value.

Prior. With q_nc = ln(L_nc / typical light of camera c), q_n is normal with a covariance S:
particles differ in size, and between cameras by their lobes of scattering. A ghost, which combines
images of different particles, seldom follows it. Positions are spread evenly, with a density
lambda from the images' light over a typical particle's.

Cost. E = 1/2 sum_cx (I_c - model)^2 / v_c + 1/2 sum_n q_n' S^-1 q_n is minus the logarithm of the
probability. With H, the second derivatives of E by a particle's position and q, a particle has to
lower E by more than its penalty (ln det H - 3 ln 2 pi) / 2 - ln lambda + (ln det S) / 2 (Laplace's
approximation). What it gains beyond that is the logarithm of its odds.

Moves (P. J. Green, Biometrika 82, 711-732, 1995), where they raise the probability:

    find    local maxima, in the volume, of the cameras' mean ln(what is left / a typical peak)
    fit     each particle, against the images less all others: a Gauss-Newton step of its position,
            and the most probable light; until a round lowers E by less than 0.03 per particle
    remove  a particle is taken out, its neighbours are fitted again, and it comes back only if E
            has risen by more than its penalty; the darkest first
    split   two in place of one, where what is left promises a gain

Course. `_share_the_light`: candidates of any light with images that are a little too wide are
fitted jointly, and the darkest are dropped in steps. `_find_most`: find, fit, remove, with floors
of the candidates' light and errors of the model that fall; learn S and typical light from particles
that stand alone, and the cameras' shifts from all. `_find_visible` and `without_wrong_cameras`:
once more without areas that something hides, or cameras that contradict the others.
`split_and_find`: split, fit, find, remove, learn the images' shapes. Last, what some cameras do not
see (`obstacles`).

Stopping. Rounds end when the number of particles grows by less than 2 %, splits when they add
none, and all at the deadline.
"""

from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from sabench.algorithms.particles import candidate_search, learned_model, obstacles
from sabench.algorithms.particles.particle_search import (
    FLOORS,
    ParticleSearch,
    joined,
    no_particles,
)
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.images.background import ClearImages, clear_images
from sabench.images.dark_noise import noise_cut_by_black
from sabench.images.widths import measure_images
from sabench.utils.arrays import F64, Bool
from sabench.utils.threads import Deadline

_ANY_LIGHT = 2.0  # scatter of the common logarithm while candidates share the light: no prior
_DARKEST = (0.05, 0.1, 0.2, 0.3, 0.4, 0.45)  # light below which candidates go, over the median
_STEPS = 3  # rounds from the first floor to the last
_GROWTH = 1.02  # of the number of particles in a round: less is the end
_UNEXPLAINED = 0.015  # of the light: more that remains has a reason
CAPS = (0.3, 0.05)  # largest error of the model, over a typical peak, first and last


@dataclass(frozen=True)
class BayesianIprSettings:
    """Settings of the search.

    Attributes
    ----------
    rounds : the most of search and removal, after the first.
    splits : the most rounds of splits, search and removal after those.
    fits : largest number of fits of all particles at each step; fewer once they converge.
    widening : modelled width of particle images over the measured one, while the first candidates
        are fitted jointly.
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
    axes = candidate_search.rig_axes(maps)
    search = search_frame(case, candidate_search.turn_maps(maps, axes), settings)
    if search is None:
        return no_particles(len(case.cameras))
    parts = obstacles.find_partly_hidden(search) if search.unexplained() > _UNEXPLAINED else []
    particles = reduce(joined, (part.found() for part in (search, *parts)))
    return candidate_search.turn_to_world(particles, axes)


def dark_images(case: Observation) -> ClearImages:
    """Return repaired images less background, flaws, and saturated pixels."""
    good = case.repaired
    light = good.images.astype(np.float32) - np.float32(case.black_dn)
    return ClearImages(*clear_images(light, good.flaws), good.images >= case.white_dn)


def _cut_noise(case: Observation) -> F64:
    """Measure the noise (camera,) of images that black cuts; 0 of others."""
    good = case.repaired
    every = zip(good.images, good.flaws.unknown, strict=True)
    return np.array([noise_cut_by_black(grey, ~unknown, case.black_dn) for grey, unknown in every])


class Known(NamedTuple):
    """Confirmed particles: positions (n, 3) mm, light (n, all cameras)."""

    position: F64
    light: F64


def search_frame(
    case: Observation,
    maps: VolumePolynomials,
    settings: BayesianIprSettings,
    confirmed: Known | None = None,
) -> ParticleSearch | None:
    """Search for a frame's particles; None if too few cameras show any.

    The first candidates share the light that known particles leave. Areas where something hides
    particles from a camera do not count. Cameras that contradict the others are left out, with a
    warning.
    """
    images = dark_images(case), _cut_noise(case)
    frame = _Frame(*images, maps, settings, Deadline(settings.budget_s), confirmed)
    search = _find_visible(frame, np.zeros(len(case.cameras), dtype=np.bool_))
    if search is None:
        return None
    if not frame.deadline.over:
        names = [camera.name for camera in case.cameras]
        search = obstacles.without_wrong_cameras(search, names, partial(_find_visible, frame))
        obstacles.warn_of_tilt(search, names)
    for _ in range(settings.splits):
        if frame.deadline.over:
            break
        learned_model.weigh_pixels(search, CAPS[1])
        if not split_and_find(search):
            break
    learned_model.weigh_pixels(search, CAPS[1])
    search.refine(2 * settings.fits)
    return search


class _Frame(NamedTuple):
    """A frame's images, and how they are searched."""

    clear: ClearImages
    cut_noise: F64
    maps: VolumePolynomials
    settings: BayesianIprSettings
    deadline: Deadline
    confirmed: Known | None


def _find_visible(frame: _Frame, wrong: Bool) -> ParticleSearch | None:
    """Find particles without wrong cameras (all cameras,) and areas that hide others."""
    search = _find_most(frame, wrong)
    if search is None or frame.deadline.over:
        return search
    shares = candidate_search.volume_shares(frame.maps, frame.clear.images.shape[1:])
    dark = obstacles.find_dark_views(search, frame.clear, shares)
    while dark.any():
        without = _find_most(frame, wrong, dark)
        if without is None or frame.deadline.over:
            break
        hidden = obstacles.keep_hidden(without, dark)
        if (hidden == dark).all():
            return without
        dark = hidden
    return search


def _find_most(frame: _Frame, wrong: Bool, hidden: Bool | None = None) -> ParticleSearch | None:
    """Find particles, except pairs that look like one, outside areas that are hidden."""
    clear, cut_noise, maps, settings, deadline, confirmed = frame
    unknown = clear.flaws.unknown if hidden is None else clear.flaws.unknown | hidden
    statistics = measure_images(clear.images.astype(np.float64), ~unknown)
    noise = np.maximum(statistics.noise, cut_noise)
    statistics = replace(statistics, shown=statistics.shown & ~wrong, noise=noise)
    if statistics.shown.sum() < candidate_search.FEWEST:
        return None
    search = ParticleSearch(clear, maps, statistics, settings.fits)
    if hidden is not None:
        search.hide(hidden)
    search.deadline = deadline
    if confirmed is not None:
        place = (confirmed.position - maps.middle_mm) / maps.half_mm
        inside = (np.abs(place) <= 1.0).all(axis=1)
        light = confirmed.light[inside][:, search.shown]
        light = np.where(light > 0.0, light, search.typical)
        search.put(place[inside], light, np.full(len(light), -1))
    search = _share_the_light(search, settings)
    for number in range(settings.rounds):
        if deadline.over:
            break
        before, along = len(search.position), min((number + 1) / _STEPS, 1.0)
        search.find(FLOORS[0] * (FLOORS[1] / FLOORS[0]) ** along)
        search.refine(settings.fits)
        learned_model.weigh_pixels(search, CAPS[0] * (CAPS[1] / CAPS[0]) ** along)
        search.remove(lone=number > 0)
        learned_model.learn_light(search)
        learned_model.align_cameras(search)
        if along == 1.0 and len(search.position) < _GROWTH * before:
            break
    return search


def split_and_find(search: ParticleSearch) -> int:
    """Split particles, add what is left, remove what gains little; count the added."""
    before = len(search.position)
    search.split()
    search.refine(search.fits)
    search.find(FLOORS[1])
    more = len(search.position) - before
    search.refine(search.fits)
    learned_model.weigh_pixels(search, CAPS[1])
    search.remove(lone=True)
    learned_model.learn_light(search)
    learned_model.learn_widths(search)
    return more


def _share_the_light(base: ParticleSearch, settings: BayesianIprSettings) -> ParticleSearch:
    """Fit the first candidates jointly, and drop the darkest, slowly.

    Known particles keep their light. The modelled images are wider than the real ones, which
    keeps chance candidates together.
    """
    search = base.rest(np.arange(len(base.typical)))
    # saturated pixels have no more light than they show, or candidates would not share it
    search.saturated = np.zeros_like(base.saturated)
    search.set_width(settings.widening * base.sigma)
    search.reset_covariance(common=_ANY_LIGHT)
    learned_model.weigh_pixels(search, CAPS[0])
    search.find(FLOORS[0])
    search.refine(settings.fits)
    for level in _DARKEST:
        learned_model.weigh_pixels(search, CAPS[0])
        search.refine(settings.fits)
        common = search.common_light()
        search.keep(common >= level * np.median(common if len(common) else 1.0))
    search.saturated = base.saturated
    search.reset_covariance()
    search.set_width(base.sigma)
    search.refine(settings.fits)
    search.images[:] = base.images
    search.subtract_all()
    if len(base.position):
        search.put(base.position, base.light, np.full(len(base.position), -1))
        search.refine(settings.fits)
    learned_model.learn_light(search)
    return search
