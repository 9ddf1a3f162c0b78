"""Particles of one frame as the most probable explanation of the images.

Iterative particle reconstruction (B. Wieneke, Meas. Sci. Technol. 24, 024008, 2013) with a
probability in place of its thresholds. A particle has a place, light with a prior that is learned
from the images, and a price. First all candidates share the light, and the darkest go, slowly. Then
particles that do not earn their price go, others are found in what is left, and pairs that look
like one are split. Widths, light, noise and shifts of the cameras come from the images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.candidate_search import BRIGHTEST, find_candidates, pixel_mm
from sabench.algorithms.particles.image_statistics import ImageStatistics, measure_images
from sabench.algorithms.particles.joint_fit import (
    ImageModel,
    Particles,
    make_room,
    put_all_in,
    refine,
    start_light,
    take_out,
)
from sabench.algorithms.particles.light_prior import (
    even_covariance,
    learn_covariance,
    scatter_between,
)
from sabench.algorithms.particles.model_moves import (
    add_camera_misses,
    find_neighbours,
    measure_misfit,
    near_any,
    remove_ghosts,
    split_pairs,
)
from sabench.algorithms.particles.refinement import in_mm, peak_brightness
from sabench.api import FoundParticles, Observation
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.images.flaws import Flaws
from sabench.utils.arrays import F32, F64, Bool

_FEWEST = 3  # cameras that must show particles
_BOX = 8.0  # volume of the box in its coordinates
_ANY_LIGHT = 2.0  # scatter of the common logarithm while candidates share the light: no prior
_BETWEEN, _COMMON = 0.1, 0.4  # first scatter between cameras, and of what they have in common
_FIRST_FLOOR = 0.35  # of the first candidates' mean light, over a typical particle's
_DARKEST = (0.05, 0.1, 0.2, 0.3, 0.4, 0.45)  # light below which candidates go, over the median
_REAL = 0.3  # of a typical particle's light: what counts for that median
_FLOORS = (0.2, 0.06)  # of the candidates of the first and the last later round
_SURE = 2.0  # standard deviations of noise: the least floor
_DIMMEST = 0.03  # of a typical peak: darker light is as good as none
_CAPS = (0.3, 0.05)  # largest error of the model, over a typical peak, first and last
_OVERLAP_PX = 3.0  # distance of images that overlap
_ALONE, _LEAST_ALONE, _HARDLY = 0.03, 60, 0.1  # share, number and overlap of lone particles
_FEW = 30  # particles that tell nothing of all
_BORDER_PX = 3.0  # where images are not complete
_MISFIT = 4.0  # standard deviations: particles that fit no better may be two
_DOUBTFUL = 0.3  # largest share of particles that are tried as two
_ALIGNMENTS, _FARTHEST_PX = 2, 0.5  # steps of cameras' shifts, and the longest of each
_APART_PX = 0.7  # of the two from their middle


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
    good = case.repaired
    images = good.images.astype(np.float32) - np.float32(case.black_dn)
    statistics = measure_images(images.astype(np.float64), ~good.flaws.unknown)
    if statistics.shown.sum() < _FEWEST:
        return FoundParticles(np.zeros((0, 3)), np.zeros(0))
    search = _Search(images, good.flaws, maps, statistics, settings)
    search.run()
    brightness = peak_brightness(search.light, search.sigma.mean(axis=1)).mean(axis=1)
    return FoundParticles(in_mm(search.maps, search.position), brightness)


class _Search:
    """State of the search: the model of the images, and the particles so far.

    Cameras that show no particles are left out.
    """

    def __init__(
        self,
        images: F32,
        flaws: Flaws,
        maps: VolumePolynomials,
        statistics: ImageStatistics,
        settings: BayesianIprSettings,
    ) -> None:
        shown = statistics.shown
        self.images: F32 = images[shown]
        self.known: Bool = ~flaws.unknown[shown]
        self.covered: Bool = flaws.covered[shown]
        self.settings = settings
        self.maps = maps._replace(coefficients=maps.coefficients[shown])
        self.number, self.noise = statistics.number, statistics.noise[shown]
        self.sigma, self.typical = statistics.sigma[shown], statistics.light[shown]
        cameras = len(self.images)
        self.room = make_room(self.sigma)
        self.covariance = even_covariance(cameras, _BETWEEN, _COMMON)
        self.left: F32 = self.images.copy()
        self.variance: F32 = np.ones_like(self.images)
        self.position: F64 = np.zeros((0, 3))
        self.light: F64 = np.zeros((0, cameras))
        self.sure: Bool = np.zeros(0, dtype=np.bool_)

    def run(self) -> None:
        """Search until the particles explain the images."""
        settings, count = self.settings, self.settings.rounds
        self._share_the_light()
        for number in range(count):
            along = (number + 1) / count
            self._find(_FLOORS[0] * (_FLOORS[1] / _FLOORS[0]) ** along)
            self._refine(settings.fits)
            self._weigh(_CAPS[0] * (_CAPS[1] / _CAPS[0]) ** along)
            self._remove(lone=number > 0)
            self._learn()
            self._align()
        for _ in range(settings.splits):
            self._weigh(_CAPS[1])
            self._split()
            self._refine(settings.fits)
            self._find(_FLOORS[1])
            self._refine(settings.fits)
            self._remove(lone=True)
            self._learn()
        self._weigh(_CAPS[1])
        self._refine(2 * settings.fits)

    def _share_the_light(self) -> None:
        """Let the first candidates share the light, and drop the darkest, slowly."""
        cameras, narrow = len(self.images), self.sigma
        self.sigma = self.settings.widening * narrow
        self.room = make_room(self.sigma)
        self.covariance = even_covariance(cameras, _BETWEEN, _ANY_LIGHT)
        self._weigh(_CAPS[0])
        self._find(_FIRST_FLOOR)
        self._refine(self.settings.fits)
        for level in _DARKEST:
            self._weigh(_CAPS[0])
            self._refine(self.settings.fits)
            common = self._common_light()
            real = common[common > _REAL]
            self._keep(common >= level * (np.median(real) if len(real) else 1.0))
        self.sigma = narrow
        self.room = make_room(self.sigma)
        self.covariance = even_covariance(cameras, _BETWEEN, _COMMON)
        self._subtract_all()
        self._refine(self.settings.fits)
        self._learn()

    def _model(self) -> ImageModel:
        precision: F64 = np.linalg.inv(self.covariance).astype(np.float64)
        weight = (self.known / self.variance).astype(np.float32)
        return ImageModel(
            self.maps,
            self.sigma,
            self.typical,
            precision,
            float(np.linalg.slogdet(precision)[1]),
            weight,
            self.left,
            math.log(self.number / _BOX),
        )

    def _particles(self) -> Particles:
        return Particles(self.position, self.light, np.ones(len(self.position), dtype=np.bool_))

    def _common_light(self) -> F64:
        """Compute the mean light (n,) over cameras, in a typical particle's."""
        return np.asarray(np.exp(np.log(self.light / self.typical).mean(axis=1)))

    def _peaks(self) -> F64:
        """Compute the brightest pixel (camera,) of a typical particle."""
        erf = np.array(
            [[math.erf(0.5 / (math.sqrt(2.0) * one)) for one in row] for row in self.sigma]
        )
        return np.asarray(self.typical * erf.prod(axis=1))

    def _refine(self, rounds: int) -> None:
        refine(self._model(), self.room, self._particles(), rounds)

    def _subtract_all(self) -> None:
        self.left[:] = self.images
        put_all_in(self._model(), self.room, self._particles())

    def _keep(self, good: Bool) -> None:
        """Drop the other particles, and give their light back."""
        model = self._model()
        for n in np.flatnonzero(~good):
            take_out(model, self.room, self.position[n], self.light[n])
        self._select(good)

    def _select(self, good: Bool) -> None:
        self.position, self.light = self.position[good], self.light[good]
        self.sure = self.sure[good]

    def _append(self, count: int, light: float) -> None:
        """Add rows for new particles."""
        self.position = np.concatenate([self.position, np.zeros((count, 3))])
        self.light = np.concatenate([self.light, np.full((count, self.light.shape[1]), light)])
        self.sure = np.concatenate([self.sure, np.zeros(count, dtype=np.bool_)])

    def _find(self, floor: float) -> None:
        """Add candidates from what is left of the images."""
        peaks = self._peaks()[:, None, None]
        dark = np.maximum(self.noise[:, None, None] / peaks, _DIMMEST)
        logs = np.log(np.clip(self.left / peaks, dark, BRIGHTEST))
        logs = np.where(self.covered, np.nan, logs).astype(np.float32)
        cameras = len(logs)
        spread = (math.sqrt(2.0 * math.log(cameras)) + 0.5) * scatter_between(self.covariance)
        least = max(floor, _SURE * float(dark.max()))
        found = find_candidates(self.maps, logs, math.log(least), spread)
        first = len(self.position)
        self._append(len(found), 0.0)
        self.position[first:] = found
        start_light(self._model(), self.room, self._particles(), first)

    def _weigh(self, cap: float) -> None:
        """Estimate the variance of every pixel from what is left.

        It is the noise of dark pixels and a share of the model's light; the part above the dark
        noise is not more than `cap` of a typical peak squared.
        """
        for camera, peak in enumerate(self._peaks()):
            known, dark = self.known[camera], self.noise[camera] ** 2
            model = np.maximum(self.images[camera] - self.left[camera], 0.0)
            squares = np.square(self.left[camera][known], dtype=np.float64)
            squares = np.minimum(squares, 30.0 * squares.mean())
            light = model[known].astype(np.float64)
            terms = np.stack([np.ones_like(light), light], axis=1)
            even, slope = np.linalg.lstsq(terms, squares, rcond=None)[0]
            variance = max(even, dark) + max(slope, 0.0) * model
            self.variance[camera] = np.minimum(variance, dark + (cap * peak) ** 2)

    def _remove(self, lone: bool) -> None:
        """Remove particles that do not earn their price, the darkest first.

        Those that earn several times their price are tried again only near others that newly do.
        """
        starts, near = find_neighbours(self.maps, self.position)
        particles, fits, model = self._particles(), self.settings.fits, self._model()
        tried = ~self.sure
        for _ in range(2):
            rows = np.flatnonzero(tried)
            order = rows[np.argsort(self._common_light()[rows], kind="stable")]
            remove_ghosts(model, self.room, particles, order, starts, near, fits, lone, self.sure)
            promoted = tried & self.sure & particles.alive
            tried = ~tried & near_any(promoted, starts, near)
        self.sure &= lone
        self._select(particles.alive)
        self._refine(1)

    def _split(self) -> None:
        """Replace particles that do not fit by two, where that is more probable."""
        count, model = len(self.position), self._model()
        misfit = np.zeros(count)
        measure_misfit(model, self.room, self._particles(), misfit)
        order = np.argsort(-misfit, kind="stable")[: int(_DOUBTFUL * count)]
        order = order[misfit[order] > _MISFIT]
        self.sure[order] = False
        self._append(len(order), 1.0)
        directions = np.array(
            [
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 3.0],
                [0.7, 0.7, 0.0],
                [0.7, -0.7, 0.0],
                [0.7, 0.0, 2.0],
                [0.0, 0.7, 2.0],
                [0.7, 0.0, -2.0],
                [0.0, 0.7, -2.0],
            ]
        )
        steps = _APART_PX * pixel_mm(self.maps) / self.maps.half_mm * directions
        count = split_pairs(model, self.room, self._particles(), order, count, steps)
        self._select(np.arange(len(self.position)) < count)

    def _learn(self) -> None:
        """Learn typical light and its covariance from the particles that stand alone."""
        if len(self.position) < _FEW:
            return
        lone = self._alone()
        if lone.sum() < _FEW:
            return
        logs = np.log(self.light[lone] / self.typical)
        self.typical = self.typical * np.exp(np.median(logs, axis=0))
        self.covariance = learn_covariance(logs)

    def _align(self) -> None:
        """Shift each camera's pixels to where it sees the particles.

        A shift that particles take part in, as one of all cameras, cannot be seen.
        """
        if len(self.position) < _FEW:
            return
        for _ in range(_ALIGNMENTS):
            sums = np.zeros((len(self.images), 5))
            add_camera_misses(self._model(), self.room, self._particles(), sums)
            xx, xy, yy, x, y = sums.T
            matrix = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=2)
            shifts = np.linalg.solve(matrix, np.stack([x, y], axis=1)[:, :, None])[:, :, 0]
            self.maps.coefficients[:, 0] += np.clip(shifts, -_FARTHEST_PX, _FARTHEST_PX)
            self._subtract_all()
            self._refine(1)

    def _alone(self) -> Bool:
        """Mark particles whose images overlap with others' the least, and are complete."""
        overlap = np.zeros(len(self.position))
        inside = np.ones(len(self.position), dtype=bool)
        last = np.array(self.images.shape[:0:-1]) - 1.0
        for camera, sigma in enumerate(self.sigma):
            pixels = project_points(self.maps, camera, self.position)
            i, j = cKDTree(pixels).query_pairs(_OVERLAP_PX, output_type="ndarray").T
            apart = np.sum((pixels[i] - pixels[j]) ** 2 / (4.0 * sigma**2), axis=1)
            shared, light = np.exp(-apart), self.light[:, camera]
            np.add.at(overlap, i, shared * light[j] / light[i])
            np.add.at(overlap, j, shared * light[i] / light[j])
            inside &= ((pixels > _BORDER_PX) & (pixels < last - _BORDER_PX)).all(axis=1)
        least = np.sort(np.where(inside, overlap, np.inf))
        rank = min(max(_LEAST_ALONE, int(_ALONE * len(overlap))), len(overlap) - 1)
        return np.asarray(inside & (overlap <= max(least[rank], _HARDLY * len(self.sigma))))
