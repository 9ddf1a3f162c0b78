"""Search for the most probable particles of one frame: its state and its moves.

The state is the images of the frame, what the particles so far leave of them, and the learned
cameras, light and noise.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable

import numpy as np
from scipy.special import expit

from sabench.algorithms.particles import all_particles, candidate_search, joint_fit, model_moves
from sabench.algorithms.particles.claimed_errors import claimed_covariances
from sabench.algorithms.particles.image_model import (
    SHAPES,
    TERMS,
    ImageModel,
    ModelParticles,
    Room,
    make_room,
    with_margins,
    without_margins,
)
from sabench.api import FoundParticles
from sabench.geometry.volume_polynomials import VolumePolynomials, points_in_mm
from sabench.images.background import ClearImages
from sabench.images.widths import PIXEL, ImageStatistics, peak_brightness
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.threads import Deadline, for_each

_BETWEEN, _COMMON = 0.1, 0.4  # first scatter between cameras, and of what they have in common
MOST_TILT = 0.7  # correlation of columns and rows in images: more is not two terms' Gaussian
_PORTIONS = 8  # of many rows, in their order: the first are fitted before the next
FLOORS = (0.2, 0.06)  # of candidates' mean light, over a typical particle's: first and last
_FLOOR = 1.1  # standard deviations of noise: the least floor of candidates
_MANY, _FIRST = 16.0, 2.5  # of the estimated number: first candidates, times cameras, and least
_MORE = 0.5  # of the particles so far: new candidates
_DIMMEST = 0.03  # of a typical peak: darker light is as good as none
_SETTLED = 0.03  # fall of the cost of a particle, on average: a round with less is the last one
_TRIAL_FITS = 2  # rounds of fits of a particle's neighbours when it is taken out for trial
# units of the cost, and times the median particle's predicted gain: particles with a larger
# predicted gain are tried. Without the second, sequences of 0.18 particles per pixel lose .03 of F1
_PROMISING, _TYPICAL = 3.0, 2.0
_APART = 1.1  # widths: distance of the two of a split from their middle


def no_particles(cameras: int) -> FoundParticles:
    """Return no particles, with all arrays of a search."""
    none, light, square = np.zeros(0), np.zeros((0, cameras)), np.zeros((0, 3, 3))
    return FoundParticles(square[:, 0], none, light=light, covariance_mm2=square, probability=none)


def joined(first: FoundParticles, other: FoundParticles) -> FoundParticles:
    """Join particles that have the same arrays."""
    more = {declared.name: value for declared, value in other.arrays()}
    pairs = {declared.name: (value, more[declared.name]) for declared, value in first.arrays()}
    return FoundParticles(**{name: np.concatenate(pair) for name, pair in pairs.items()})


# arrays of a search that have one row for each particle
_BY_PARTICLE = ("position", "light", "sure", "trusted", "tag", "odds")
# and for each of its cameras
_BY_CAMERA = (
    *("noise", "typical", "tilt", "shapes", "first_shapes"),
    *("variance", "known", "covered", "saturated", "framed_left"),
)


class ParticleSearch:
    """Search that adds, fits, removes and splits particles of a frame's images.

    Cameras that show no particles are left out.

    Attributes
    ----------
    images, known, covered, saturated : (camera, row, column) less black; which pixels count; which
        hide what is behind them; which show less light than there is.
    left, variance : the images less all particles, and the variance of each pixel.
    position, light : (n, 3) in the box of the maps, (n, camera).
    hidden : (all cameras, row, column) areas that something hides from a camera in every frame.
    sure : (n,) whether a particle gained several times its penalty.
    trusted : (n,) whether a caller confirms a particle: it is not tried.
    odds : (n,) logarithm of the odds that it is real.
    tag : (n,) numbers that a caller gave particles, -1 for those found here.
    deadline : after it, particles are no longer found, fitted, removed or split.
    """

    images: F32
    known: Bool
    covered: Bool
    saturated: Bool
    left: F32
    variance: F32
    position: F64
    light: F64
    sure: Bool
    trusted: Bool
    odds: F64
    tag: I64
    deadline: Deadline = Deadline()

    def __init__(
        self, clear: ClearImages, maps: VolumePolynomials, statistics: ImageStatistics, fits: int
    ) -> None:
        """Start without particles; all are fitted `fits` times before removals, at most."""
        self.shown, self.fits, self.number = statistics.shown, fits, statistics.number
        self.maps = maps._replace(coefficients=maps.coefficients[self.shown])
        each = statistics.noise, statistics.light, statistics.tilt
        self.noise, self.typical, self.tilt = (values[self.shown] for values in each)
        self.hidden: Bool | None = None
        self.reset_covariance()
        self.show(clear)
        self.set_width(statistics.sigma[self.shown])

    def show(self, clear: ClearImages) -> None:
        """Take the images of a frame, with all cameras, and no particles."""
        images, flaws, saturated = clear
        self.images, self.saturated = images[self.shown], saturated[self.shown]
        self.covered, self.known = flaws.covered[self.shown], ~flaws.unknown[self.shown]
        if self.hidden is not None:
            self.hide(self.hidden)
        self.framed, self.framed_left = with_margins(self.images), with_margins(self.images)
        self.images = without_margins(self.framed)
        self.left, self.variance = without_margins(self.framed_left), np.ones_like(self.images)
        self.position, self.light = np.zeros((0, 3)), np.zeros((0, len(self.images)))
        self.sure, self.trusted = np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
        self.tag, self.odds = np.zeros(0, dtype=np.int64), np.zeros(0)

    def hide(self, areas: Bool) -> None:
        """Hide areas (all cameras, row, column) of the images."""
        self.hidden = areas
        self.covered |= areas[self.shown]
        self.known &= ~areas[self.shown]

    def set_width(self, sigma: F64) -> None:
        """Set Gaussians of widths (camera, 2) everywhere, with the measured tilt."""
        tilt = np.clip(self.tilt, -MOST_TILT, MOST_TILT)
        shapes = np.zeros((len(sigma), SHAPES, TERMS))
        shapes[:, :2, 0], shapes[:, 2, 0] = sigma, tilt * sigma.prod(axis=1)
        self.set_shapes(shapes)

    def set_shapes(self, shapes: F64) -> None:
        """Set the shapes of images, before more is learned of them."""
        self.shapes, self.first_shapes = shapes, shapes.copy()
        self.subtract_all()

    @property
    def sigma(self) -> F64:
        """Widths (camera, 2) of the particles' images in the middle of the box, px."""
        return self.shapes[:, :2, 0]

    @property
    def room(self) -> Room:
        """Room for one thread to work in."""
        return make_room(self.sigma)

    @property
    def widest(self) -> F64:
        """Widths (camera, 2), px, for windows that hold images of any width so far."""
        return np.asarray(np.maximum(self.first_shapes[:, :2, 0], self.sigma))

    def reset_covariance(self, between: float = _BETWEEN, common: float = _COMMON) -> None:
        """Forget the covariance of light that was learned."""
        self.covariance = joint_fit.even_covariance(len(self.typical), between, common)

    def found(self) -> FoundParticles:
        """Return the particles."""
        brightness = self._lowered() * peak_brightness(self.light, self.sigma.mean(axis=1))
        light = np.zeros((len(self.light), len(self.shown)))
        light[:, self.shown] = self.light
        position = points_in_mm(self.maps, self.position)
        errors = claimed_covariances(self.model(), self.particles(), self.noise)
        return FoundParticles(
            position,
            brightness.mean(axis=1),
            light=light,
            covariance_mm2=errors,
            probability=expit(self.odds),
        )

    def put(self, position: F64, light: F64, tag: I64) -> None:
        """Put in particles, whatever the images show."""
        first = len(self.position)
        self.append(position, light)
        self.tag[first:], self.odds[first:] = tag, np.inf
        self.subtract_all()

    def miss(self, camera: int) -> F32:
        """Return what is left of an image; 0 where a saturated pixel has enough."""
        left, enough = self.left[camera], self.saturated[camera] & (self.left[camera] < 0.0)
        return np.where(enough, np.float32(0.0), left)

    def model(self) -> ImageModel:
        """Make the kernels' view of images and what is left of them."""
        precision: F64 = np.linalg.inv(self.covariance).astype(np.float64)
        weight = np.zeros_like(self.framed)

        def fill(camera: int) -> None:
            each = np.where(self.saturated[camera], np.float32(-1.0), np.float32(1.0))
            each /= self.variance[camera]
            without_margins(weight[camera])[:] = np.where(self.known[camera], each, 0.0)

        for_each(fill, len(weight))
        cameras = self.maps, self.shapes, self.typical, precision
        determinant = float(np.linalg.slogdet(precision)[1])
        images = self.framed, weight, self.framed_left
        log_rate = math.log(self.number) - 3.0 * math.log(2.0)  # the box is from -1 to 1
        return ImageModel(*cameras, determinant, *images, log_rate)

    def particles(self) -> ModelParticles:
        """Make the kernels' view of the particles, all alive."""
        alive = np.ones(len(self.position), dtype=np.bool_)
        return ModelParticles(self.position, self.light, alive)

    def unexplained(self) -> float:
        """Compute the share of the light that is left; the median over the cameras."""
        shares = [
            float(self.miss(camera)[valid].sum() / max(image[valid].sum(), 1e-6))
            for camera, (image, valid) in enumerate(zip(self.images, self.known, strict=True))
        ]
        return float(np.median(shares))

    def common_light(self) -> F64:
        """Compute the mean light (n,) over cameras, in a typical particle's."""
        return np.asarray(np.exp(np.log(self.light / self.typical).mean(axis=1)))

    def peaks(self, sigma: F64 | None = None) -> F64:
        """Compute the brightest pixel (camera,) of a typical particle, of given widths."""
        widths = self.sigma if sigma is None else sigma
        erf = np.array([[math.erf(0.5 / (math.sqrt(2.0) * w)) for w in row] for row in widths])
        return np.asarray(self.typical * erf.prod(axis=1) * self._lowered())

    def _lowered(self) -> F64:
        """Estimate the peaks (camera,) of images over those of Gaussians."""
        area = self.sigma.prod(axis=1)
        return np.asarray(1.0 - 8.0 * self.shapes[:, 3, 0] * (area / (area + PIXEL)) ** 2)

    def subtract_all(self) -> None:
        """Compute anew what all particles leave of the images."""
        self.framed_left[:] = self.framed
        all_particles.paint_particles(self.model(), self.widest, self.particles(), -1.0)

    def keep(self, good: Bool) -> None:
        """Drop the other particles, and add their light to what is left."""
        dropped = ModelParticles(self.position[~good], self.light[~good], ~good[~good])
        all_particles.paint_particles(self.model(), self.widest, dropped, 1.0)
        self.select(good)

    def select(self, good: Bool | I64) -> None:
        """Keep these rows, in this order, whatever the images show."""
        for name in _BY_PARTICLE:
            setattr(self, name, getattr(self, name)[good])

    def rest(self, seeing: I64) -> ParticleSearch:
        """Copy the search for some cameras, without particles.

        What the particles leave are the copy's images.
        """
        part = copy.copy(self)
        part.shown = np.zeros_like(self.shown)
        part.shown[np.flatnonzero(self.shown)[seeing]] = True
        part.maps = self.maps._replace(coefficients=self.maps.coefficients[seeing])
        part.covariance = self.covariance[np.ix_(seeing, seeing)]
        for name in _BY_CAMERA:
            setattr(part, name, getattr(self, name)[seeing])
        part.framed = part.framed_left.copy()
        part.images, part.left = without_margins(part.framed), without_margins(part.framed_left)
        part.light = self.light[:, seeing]
        part.select(np.zeros(len(self.position), dtype=np.bool_))
        return part

    def append(self, position: F64, light: F64) -> None:
        """Add rows for new particles."""
        for name in _BY_PARTICLE:
            rows = getattr(self, name)
            new = np.zeros((len(position), *rows.shape[1:]), rows.dtype)
            setattr(self, name, np.concatenate([rows, new]))
        first = len(self.position) - len(position)
        self.position[first:], self.light[first:], self.tag[first:] = position, light, -1

    def refine(self, rounds: int) -> None:
        """Fit all particles in rounds, until one hardly lowers the cost or time is over."""
        model, particles = self.model(), self.particles()
        rows, changes = np.arange(len(self.position)), [0.0]
        turns = self._turns(rows, portions=1)

        def fit(some: I64) -> None:
            changes.append(joint_fit.fit_particles(model, self.room, particles, some))

        for _ in range(rounds):
            changes.clear()
            self._work(fit, turns)
            if sum(changes) >= -_SETTLED * len(rows):
                break

    def _turns(
        self, rows: I64, neighbours: tuple[I64, I64] | None = None, portions: int = _PORTIONS
    ) -> list[list[I64]]:
        window = make_room(self.widest).profiles.shape[2]
        pixel = candidate_search.pixel_mm(self.maps)
        each = self.maps, self.position, rows, window, pixel
        return all_particles.disjoint_groups(*each, portions, neighbours)

    def _work(self, work: Callable[[I64], None], turns: list[list[I64]]) -> None:
        in_time = itertools.takewhile(lambda _: not self.deadline.over, turns)
        all_particles.side_by_side(work, in_time)

    def find(self, floor: float) -> None:
        """Add the brightest candidates from what is left, not too many together."""
        if self.deadline.over:
            return
        left, sigma = candidate_search.wide_enough(self.left, self.sigma)
        peaks = self.peaks(sigma)[:, None, None]
        dark = np.maximum(self.noise[:, None, None] / peaks, _DIMMEST)
        logs = np.log(np.clip(left / peaks, dark, candidate_search.BRIGHTEST))
        enough = self.saturated & (self.left <= 0.0)
        logs = np.where(self.covered | enough, np.nan, logs).astype(np.float32)
        cameras = len(logs)
        scatter = joint_fit.scatter_between(self.covariance)
        spread = (math.sqrt(2.0 * math.log(cameras)) + 0.5) * scatter
        least = max(floor, _FLOOR * float(dark.max()))
        first = len(self.position)
        position = candidate_search.find_candidates(self.maps, logs, math.log(least), spread)
        share = max(_MANY / cameras, _FIRST)  # the more cameras, the fewer meet by chance
        most = _MORE * max(first, self.number) if first else share * self.number
        position = position[: int(most)]
        self.append(position, np.zeros((len(position), cameras)))
        model, particles = self.model(), self.particles()

        def start(rows: I64) -> None:
            joint_fit.start_light(model, self.room, particles, rows)

        self._work(start, self._turns(np.arange(first, len(self.position)), portions=1))
        self.select(np.all(self.light > 0.0, axis=1))  # all, unless time was over
        pixel = candidate_search.pixel_mm(self.maps)
        self.select(all_particles.order_in_memory(self.maps, self.position, pixel))

    def remove(self, lone: bool) -> None:
        """Remove particles that gain less than their penalty, the darkest first.

        All are fitted before, or what neighbours gain by their own fits would count against a
        particle that is taken out. Those that gain several times their penalty are not tried again.
        """
        self.refine(self.fits)
        starts, near = model_moves.find_neighbours(self.maps, self.sigma, self.position)
        particles, model = self.particles(), self.model()

        def remove(rows: I64) -> None:
            each = self.room, particles, rows, starts, near
            model_moves.remove_ghosts(model, *each, _TRIAL_FITS, lone, self.sure, self.odds)

        rows = np.flatnonzero(~self.sure & ~self.trusted)
        order = rows[np.argsort(self.common_light()[rows], kind="stable")]
        self._work(remove, self._turns(order, (starts, near)))
        self.select(particles.alive)
        self.refine(1)

    def split(self) -> None:
        """Replace particles by two if that is more probable.

        What is left in the images selects those to try.
        """
        count, model = len(self.position), self.model()
        width = float(self.sigma.max())
        steps = _APART * width / self.maps.half_mm * candidate_search.split_directions(self.maps)
        gains = all_particles.split_gains(model, self.widest, self.particles(), steps)
        least = _PROMISING + _TYPICAL * float(np.median(gains)) if count else 0.0
        order = np.argsort(-gains, kind="stable")
        order = order[gains[order] > least]
        self.sure[order] = False
        self.append(self.position[order], self.light[order])
        spare = np.zeros(count, dtype=np.int64)
        spare[order] = np.arange(count, len(self.position))
        particles = self.particles()
        particles.alive[count:] = False

        def split(rows: I64) -> None:
            model_moves.split_pairs(model, self.room, particles, rows, spare, steps)

        self._work(split, self._turns(order, portions=1))
        self.select(particles.alive)
