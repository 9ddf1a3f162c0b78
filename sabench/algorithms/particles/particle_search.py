"""State and moves of a search for the most probable particles of one frame.

A particle has a place, light with a prior that is learned from the images, and a price.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from sabench.algorithms.particles.background import ClearImages
from sabench.algorithms.particles.candidate_search import (
    BRIGHTEST,
    find_candidates,
    pixel_mm,
    split_directions,
)
from sabench.algorithms.particles.claimed_errors import claimed_covariances
from sabench.algorithms.particles.disjoint_groups import disjoint_groups, side_by_side
from sabench.algorithms.particles.image_model import (
    ImageModel,
    Particles,
    make_room,
    put_all_in,
    take_out,
    with_margins,
    without_margins,
)
from sabench.algorithms.particles.image_statistics import ImageStatistics
from sabench.algorithms.particles.joint_fit import refine, start_light
from sabench.algorithms.particles.light_prior import (
    even_covariance,
    learn_covariance,
    scatter_between,
)
from sabench.algorithms.particles.lone_particles import find_lone
from sabench.algorithms.particles.model_moves import (
    add_camera_misses,
    add_width_misses,
    find_neighbours,
    measure_misfit,
    near_any,
    remove_ghosts,
    split_pairs,
)
from sabench.algorithms.particles.time_budget import Deadline
from sabench.api import FoundParticles
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    points_in_mm,
)
from sabench.images.particle_widths import peak_brightness
from sabench.utils.arrays import F32, F64, I64, Bool

_BOX = 8.0  # volume of the box in its coordinates
_BETWEEN, _COMMON = 0.1, 0.4  # first scatter between cameras, and of what they have in common
_FLOOR = 2.0  # standard deviations of noise: the least floor of candidates
_MORE = 0.5  # of the particles so far: candidates beside them
_DIMMEST = 0.03  # of a typical peak: darker light is as good as none
_FEW = 30  # particles that tell nothing of all
_MISFIT = 4.0  # standard deviations: particles that fit no better may be two
_DOUBTFUL = 0.3  # largest share of particles that are tried as two
_ALIGNMENTS, _FARTHEST_PX = 2, 0.5  # steps of cameras' shifts, and the longest of each
_WIDTH_ERROR, _WIDTH_CHANGE = 0.2, 0.05  # of the first widths, and over the box: their scatter
_WIDTH_STEPS = 2
_OWN_ERROR = 0.03  # of a particle's image: particles differ
_UNKNOWN = 0.25  # of light that is left: other particles' tails do not explain it
_APART = 1.1  # widths: distance of the two of a split from their middle
_CERTAIN = 30.0  # logarithm of the highest odds


def no_particles(cameras: int) -> FoundParticles:
    """Return no particles, with all that a search tells of them."""
    none = np.zeros(0)
    return FoundParticles(
        np.zeros((0, 3)),
        none,
        light=np.zeros((0, cameras)),
        covariance_mm2=np.zeros((0, 3, 3)),
        probability=none,
    )


def joined(one: FoundParticles, other: FoundParticles) -> FoundParticles:
    """Join particles of which the same is known."""
    more = {declared.name: value for declared, value in other.arrays()}
    return FoundParticles(
        **{
            declared.name: np.concatenate([value, more[declared.name]])
            for declared, value in one.arrays()
        }
    )


class ParticleSearch:
    """State of the search: the model of the images, and the particles so far.

    Cameras that show no particles are left out.

    Attributes
    ----------
    images, known, covered, saturated : (camera, row, column) less black; which pixels count; which
        tell nothing of what is behind them; which show less light than there is.
    left, variance : the images less all particles, and the variance of each pixel.
    position, light : (n, 3) in the box of the maps, (n, camera).
    hidden : (all cameras, row, column) areas that something hides from a camera in every frame.
    sure : (n,) whether a particle earned several times its price.
    trusted : (n,) whether a caller has other reasons to take a particle for real: it is not tried.
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
        self,
        clear: ClearImages,
        maps: VolumePolynomials,
        statistics: ImageStatistics,
        fits: int,
    ) -> None:
        """Start without particles; a trial of removal fits neighbours `fits` times."""
        self.shown, self.fits = statistics.shown, fits
        self.maps = maps._replace(coefficients=maps.coefficients[self.shown])
        self.number, self.noise = statistics.number, statistics.noise[self.shown]
        self.typical = statistics.light[self.shown]
        self.hidden: Bool | None = None
        self.reset_covariance()
        self.show(clear)
        self.set_width(statistics.sigma[self.shown])

    def show(self, clear: ClearImages) -> None:
        """Take the images of a frame, with all cameras, and no particles."""
        images, flaws, saturated = clear
        self.images, self.saturated = images[self.shown], saturated[self.shown]
        covered = flaws.covered if self.hidden is None else flaws.covered | self.hidden
        self.covered = covered[self.shown]
        self.known = ~(flaws.points | covered)[self.shown]
        self.framed, self.framed_left = with_margins(self.images), with_margins(self.images)
        self.images = without_margins(self.framed)
        self.left, self.variance = without_margins(self.framed_left), np.ones_like(self.images)
        self.position, self.light = np.zeros((0, 3)), np.zeros((0, len(self.images)))
        self.sure, self.trusted = np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.bool_)
        self.tag = np.zeros(0, dtype=np.int64)
        self.odds = np.zeros(0)

    def set_width(self, sigma: F64) -> None:
        """Set the widths (camera, 2) of the particles' images, the same everywhere."""
        self.widths = np.concatenate([sigma[:, :, None], np.zeros((*sigma.shape, 3))], axis=2)
        self.first_widths, self.room = self.widths.copy(), make_room(sigma)
        self.subtract_all()

    @property
    def sigma(self) -> F64:
        """Widths (camera, 2) of the particles' images in the middle of the box, px."""
        return self.widths[:, :, 0]

    def reset_covariance(self, between: float = _BETWEEN, common: float = _COMMON) -> None:
        """Forget the covariance of light that was learned."""
        self.covariance = even_covariance(len(self.typical), between, common)

    def found(self) -> FoundParticles:
        """Return the particles."""
        brightness = peak_brightness(self.light, self.sigma.mean(axis=1)).mean(axis=1)
        light = np.zeros((len(self.light), len(self.shown)))
        light[:, self.shown] = self.light
        return FoundParticles(
            points_in_mm(self.maps, self.position),
            brightness,
            light=light,
            covariance_mm2=claimed_covariances(
                self.model(), self.room, self.particles(), self.noise
            ),
            probability=1.0 / (1.0 + np.exp(-np.clip(self.odds, -_CERTAIN, _CERTAIN))),
        )

    def put(self, position: F64, light: F64, tag: I64) -> None:
        """Put in particles, whatever the images show."""
        first = len(self.position)
        self.append(len(position), 1.0)
        self.position[first:], self.light[first:], self.tag[first:] = position, light, tag
        self.odds[first:] = _CERTAIN
        self.subtract_all()

    def miss(self, camera: int) -> F32:
        """Return what is left of an image; 0 where a saturated pixel has enough."""
        left, enough = self.left[camera], self.saturated[camera] & (self.left[camera] < 0.0)
        return np.where(enough, np.float32(0.0), left)

    def model(self) -> ImageModel:
        """Make the kernels' view of images and what is left of them."""
        precision: F64 = np.linalg.inv(self.covariance).astype(np.float64)
        sign = np.where(self.saturated, np.float32(-1.0), np.float32(1.0))
        weight = (sign * self.known / self.variance).astype(np.float32)
        return ImageModel(
            self.maps,
            self.widths,
            self.typical,
            precision,
            float(np.linalg.slogdet(precision)[1]),
            float(np.linalg.eigvalsh(precision)[0]),
            self.framed,
            with_margins(weight),
            self.framed_left,
            math.log(self.number / _BOX),
        )

    def particles(self) -> Particles:
        """Make the kernels' view of the particles, all alive."""
        return Particles(self.position, self.light, np.ones(len(self.position), dtype=np.bool_))

    def unexplained(self) -> float:
        """Compute the share of the light that is left; the median over the cameras."""
        shares = [
            float(self.miss(camera)[known].sum() / max(image[known].sum(), 1e-6))
            for camera, (image, known) in enumerate(zip(self.images, self.known, strict=True))
        ]
        return float(np.median(shares))

    def common_light(self) -> F64:
        """Compute the mean light (n,) over cameras, in a typical particle's."""
        return np.asarray(np.exp(np.log(self.light / self.typical).mean(axis=1)))

    def _peaks(self) -> F64:
        """Compute the brightest pixel (camera,) of a typical particle."""
        erf = np.array(
            [[math.erf(0.5 / (math.sqrt(2.0) * one)) for one in row] for row in self.sigma]
        )
        return np.asarray(self.typical * erf.prod(axis=1))

    def refine(self, rounds: int) -> None:
        """Fit all particles, one after the other, in several rounds, as time allows."""
        model, particles = self.model(), self.particles()

        def fit(rows: I64) -> None:
            refine(model, make_room(self.sigma), particles, rows)

        self._each(fit, np.arange(len(self.position)), rounds=rounds)

    def _each(
        self,
        work: Callable[[I64], None],
        rows: I64,
        neighbours: tuple[I64, I64] | None = None,
        rounds: int = 1,
    ) -> None:
        """Work on rows, side by side where they share no pixel, as time allows.

        Neighbours, if given, are changed, too.
        """
        window, pixel = self.room.x.shape[1], pixel_mm(self.maps)
        turns = disjoint_groups(self.maps, self.position, rows, window, pixel, neighbours)
        in_time = itertools.takewhile(lambda _: not self.deadline.over, rounds * turns)
        side_by_side(work, in_time)

    def subtract_all(self) -> None:
        """Compute anew what all particles leave of the images."""
        self.framed_left[:] = self.framed
        put_all_in(self.model(), self.room, self.particles())

    def keep(self, good: Bool) -> None:
        """Drop the other particles, and give their light back."""
        model = self.model()
        for n in np.flatnonzero(~good):
            take_out(model, self.room, self.position[n], self.light[n])
        self.select(good)

    def select(self, good: Bool) -> None:
        """Keep these rows, whatever the images show."""
        self.position, self.light = self.position[good], self.light[good]
        self.sure, self.tag, self.odds = self.sure[good], self.tag[good], self.odds[good]
        self.trusted = self.trusted[good]

    def append(self, count: int, light: float) -> None:
        """Add rows for new particles."""
        self.position = np.concatenate([self.position, np.zeros((count, 3))])
        self.light = np.concatenate([self.light, np.full((count, self.light.shape[1]), light)])
        self.sure = np.concatenate([self.sure, np.zeros(count, dtype=np.bool_)])
        self.trusted = np.concatenate([self.trusted, np.zeros(count, dtype=np.bool_)])
        self.tag = np.concatenate([self.tag, np.full(count, -1)])
        self.odds = np.concatenate([self.odds, np.zeros(count)])

    def find(self, floor: float) -> None:
        """Add candidates from what is left of the images, the brightest.

        Many at once would take each other's light, and that of particles.
        """
        if self.deadline.over:
            return
        peaks = self._peaks()[:, None, None]
        dark = np.maximum(self.noise[:, None, None] / peaks, _DIMMEST)
        logs = np.log(np.clip(self.left / peaks, dark, BRIGHTEST))
        enough = self.saturated & (self.left <= 0.0)
        logs = np.where(self.covered | enough, np.nan, logs).astype(np.float32)
        cameras = len(logs)
        spread = (math.sqrt(2.0 * math.log(cameras)) + 0.5) * scatter_between(self.covariance)
        least = max(floor, _FLOOR * float(dark.max()))
        found = find_candidates(self.maps, logs, math.log(least), spread)
        first = len(self.position)
        if first:
            found = found[: int(_MORE * max(first, self.number))]
        self.append(len(found), 0.0)
        self.position[first:] = found
        model, particles = self.model(), self.particles()

        def start(rows: I64) -> None:
            start_light(model, make_room(self.sigma), particles, rows)

        self._each(start, np.arange(first, len(self.position)))
        self.select(np.all(self.light > 0.0, axis=1))  # all, unless time was over

    def weigh(self, cap: float) -> None:
        """Estimate the variance of every pixel from what is left.

        It is the noise of dark pixels and a share of the model's light; the part above the dark
        noise is at most `cap` of a typical peak squared, but not less than what particles leave
        whose images are a little wider or narrower than others', or what particles that are not
        found yet leave.
        """
        for camera, peak in enumerate(self._peaks()):
            known, dark = self.known[camera], self.noise[camera] ** 2
            # no more than the image shows, or particles that are too bright would hide it
            image = np.maximum(self.images[camera], 0.0)
            model = np.clip(self.images[camera] - self.left[camera], 0.0, image)
            miss = self.miss(camera)
            squares = np.square(miss[known], dtype=np.float64)
            squares = np.minimum(squares, 30.0 * squares.mean())
            light = model[known].astype(np.float64)
            terms = np.stack([np.ones_like(light), light], axis=1)
            even, slope = np.linalg.lstsq(terms, squares, rcond=None)[0]
            variance = np.minimum(
                max(even, dark) + max(slope, 0.0) * model, dark + (cap * peak) ** 2
            )
            least = (_OWN_ERROR * model) ** 2 + (_UNKNOWN * miss) ** 2
            self.variance[camera] = np.maximum(variance, dark + least)

    def remove(self, lone: bool) -> None:
        """Remove particles that do not earn their price, the darkest first.

        Those that earn several times their price are tried again only near others that newly do.
        """
        starts, near = find_neighbours(self.maps, self.sigma, self.position)
        particles, model = self.particles(), self.model()
        tried = ~self.sure & ~self.trusted

        def remove(rows: I64) -> None:
            room = make_room(self.sigma)
            remove_ghosts(
                model, room, particles, rows, starts, near, self.fits, lone, self.sure, self.odds
            )

        for _ in range(2):
            rows = np.flatnonzero(tried)
            order = rows[np.argsort(self.common_light()[rows], kind="stable")]
            self._each(remove, order, (starts, near))
            promoted = tried & self.sure & particles.alive
            tried = ~tried & ~self.trusted & near_any(promoted, starts, near)
        self.sure &= lone
        self.select(particles.alive)
        self.refine(1)

    def split(self) -> None:
        """Replace particles that do not fit by two, where that is more probable."""
        count, model = len(self.position), self.model()
        misfit = np.zeros(count)
        measure_misfit(model, self.room, self.particles(), misfit)
        order = np.argsort(-misfit, kind="stable")[: int(_DOUBTFUL * count)]
        order = order[misfit[order] > _MISFIT]
        self.sure[order] = False
        self.append(len(order), 1.0)
        spare = np.zeros(count, dtype=np.int64)
        spare[order] = np.arange(count, len(self.position))
        particles = self.particles()
        particles.alive[count:] = False
        width = float(self.sigma.max())
        steps = _APART * width / self.maps.half_mm * split_directions(self.maps)

        def split(rows: I64) -> None:
            split_pairs(model, make_room(self.sigma), particles, rows, spare, steps)

        self._each(split, order)
        self.select(particles.alive)

    def learn(self) -> None:
        """Learn typical light and its covariance from the particles that stand alone."""
        lone = self._lone()
        if len(lone) < _FEW:
            return
        logs = np.log(self.light[lone] / self.typical)
        self.typical = self.typical * np.exp(np.median(logs, axis=0))
        self.covariance = learn_covariance(logs)

    def learn_widths(self) -> None:
        """Learn the widths of images, and how they change, from lone particles.

        Half of them count, those that leave least of their images: others may be two. Few must be
        missing yet, because what they leave makes others wider.
        """
        lone = self._lone()
        if len(lone) < _FEW:
            return
        model, particles, cameras = self.model(), self.particles(), len(self.images)
        misfit = np.zeros(len(self.position))
        measure_misfit(model, self.room, particles, misfit)
        misfit = misfit[lone] / self.common_light()[lone] ** 2
        lone = lone[misfit <= np.median(misfit)]
        for _ in range(_WIDTH_STEPS):
            matrices, right = np.zeros((cameras, 8, 8)), np.zeros((cameras, 8))
            add_width_misses(model, self.room, particles, lone, matrices, right)
            sigma = np.repeat(self.sigma[:, :, None], 4, axis=2)
            known = (np.array([_WIDTH_ERROR, *[_WIDTH_CHANGE] * 3]) * sigma).reshape(-1, 8) ** -2.0
            right -= known * (self.widths - self.first_widths).reshape(-1, 8)
            matrices += known[:, :, None] * np.eye(8)
            step = np.linalg.solve(matrices, right[:, :, None]).reshape(self.widths.shape)
            most = _WIDTH_CHANGE * sigma
            self.widths += np.clip(step, -most, most)
            self.subtract_all()

    def align(self) -> None:
        """Shift each camera's pixels to where it sees the particles.

        A shift that particles take part in, as one of all cameras, cannot be seen.
        """
        if len(self.position) < _FEW:
            return
        for _ in range(_ALIGNMENTS):
            sums = np.zeros((len(self.images), 5))
            add_camera_misses(self.model(), self.room, self.particles(), sums)
            xx, xy, yy, x, y = sums.T
            matrix = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=2)
            shifts = np.zeros((len(matrix), 2))
            there = np.linalg.det(matrix) > 0.0  # cameras that see some particles
            right = np.stack([x, y], axis=1)[there, :, None]
            shifts[there] = np.linalg.solve(matrix[there], right)[:, :, 0]
            self.maps.coefficients[:, 0] += np.clip(shifts, -_FARTHEST_PX, _FARTHEST_PX)
            self.subtract_all()
            self.refine(1)

    def _lone(self) -> I64:
        return find_lone(self.maps, self.position, self.light, self.sigma, self.images.shape[1:])
