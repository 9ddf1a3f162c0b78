"""Volume self-calibration: disparities, particles, adjusted cameras."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import Anchor, BoardImages, refine, residuals
from sabench.algorithms.calibration.disparity import SETS, Sets, correct, find_sets, pair_up
from sabench.algorithms.calibration.joint_fit import CAUCHY, SAME_NOISE, median_noise
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.algorithms.particles.candidate_search import rig_axes, turn_maps
from sabench.algorithms.particles.matching import detect_in_cameras
from sabench.api import Observation
from sabench.geometry.camera import Camera
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    fit_volume_polynomials,
    points_in_mm,
    project_points,
)
from sabench.images.dark_noise import FALSE_ALARMS
from sabench.images.peaks import Peaks, find_peaks
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError

_ROUNDS = 20
_SETTLED_PX = 0.03
# times reach_px: the core's common errors move all positions, so that another camera's disparity
# may be larger than its own error
_FARTHER = 3.0
_CORE = 4  # cameras that are matched all with all
_MOST = 3000  # particles that the cameras are adjusted to
_LATTICE = (5, 5, 3)
_NOMINAL_PX = 2.0  # standard deviation of the nominal cameras' pixels
# standard deviations of right sets above chance: the most crowded of many spots of wrong
# ones has a dozen
_SURE = 20.0


@dataclass(frozen=True)
class Tracking:
    """Case prepared for matching.

    Attributes
    ----------
    cameras : nominal cameras, those of the core first.
    order : numbers of these cameras in the case.
    peaks : particle images of these cameras.
    maps : polynomials of the nominal cameras, in a box along the rig's axes.
    axes : (3, 3) the rig's axes as rows.
    """

    cameras: tuple[Camera, ...]
    order: tuple[int, ...]
    peaks: tuple[Peaks, ...]
    maps: VolumePolynomials
    axes: F64

    @classmethod
    def from_case(
        cls, case: Observation, bright: float, false_alarms: float = FALSE_ALARMS
    ) -> Tracking:
        """Find particle images, and order the cameras.

        Cameras with the most different positions come first.

        Parameters
        ----------
        bright : least peak of a particle image, over a bright one's.
        false_alarms : probability that noise makes a particle image of a pixel; the larger of both
            thresholds holds.
        """
        pinholes = tuple(camera for camera in case.cameras if isinstance(camera, Camera))
        if len(pinholes) != len(case.cameras):
            raise InputError(
                "expected pinhole cameras, whose parameters can be adjusted, got others"
            )
        order = _spread(np.array([camera.center_mm for camera in pinholes]))
        every = detect_in_cameras(case, bright, false_alarms)
        light = case.normalised_images()
        # where particles leave no dark pixels, their light counts as noise
        peaks = tuple(
            every[number] if len(every[number].pixels) else find_peaks(light[number], bright)
            for number in order
        )
        for number, camera_peaks in zip(order, peaks, strict=True):
            if not len(camera_peaks.pixels):
                raise InputError(
                    f"{pinholes[number].name}: expected particle images, got none above "
                    f"{bright:g} of a bright one's peak"
                )
        cameras = tuple(pinholes[number] for number in order)
        maps = fit_volume_polynomials(cameras, *case.grid.centers_mm())
        axes = rig_axes(maps)
        return cls(cameras, tuple(order), peaks, turn_maps(maps, axes), axes)


def _spread(centers: F64) -> list[int]:
    """Order cameras, each the farthest from those before it, the outermost first."""
    order = [int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmax())]
    while len(order) < len(centers):
        away = np.linalg.norm(centers[:, None] - centers[order], axis=2).min(axis=1)
        order.append(int(np.argmax(np.where(np.isin(np.arange(len(centers)), order), -1.0, away))))
    return order


def follow_disparities(tracking: Tracking, reach_px: float, least_px: float) -> VolumePolynomials:
    """Correct polynomials by disparities of the core, then of each camera against it."""
    core = range(min(_CORE, len(tracking.cameras)))
    peaks = tracking.peaks[: len(core)]

    def find_in_core(maps: VolumePolynomials, radius: float) -> Sets:
        sets = find_sets(maps, peaks, radius)
        if not len(sets.positions):
            raise InputError(
                f"expected particle images that agree within {radius:g} px, got none: larger "
                "errors need a larger reach_px"
            )
        return sets

    maps = _reduce(tracking.maps, core, find_in_core, reach_px, least_px)
    sure = find_sets(maps, peaks, least_px)
    # the number of chance sets grows as the radius to the power of the dimensions of their errors
    wider = find_sets(maps, peaks, 2.0 * least_px)
    chance = (len(wider.positions) - len(sure.positions)) / (2.0 ** (2 * len(core) - 3) - 1.0)
    if len(sure.positions) - chance < _SURE * np.sqrt(max(chance, 1.0)):
        raise InputError(
            f"expected sets of particle images of {len(core)} cameras that agree within "
            f"{least_px:g} px, got {len(sure.positions)} where chance makes "
            f"{chance:.0f}: errors are larger than reach_px = {reach_px:g}, or particles too many"
        )
    for camera in range(len(core), len(tracking.cameras)):
        find = partial(_find_in_camera, tracking, sure, camera)
        farthest = _FARTHER * reach_px
        maps = _reduce(maps, range(camera, camera + 1), find, farthest, least_px)
    return maps


def _reduce(
    maps: VolumePolynomials,
    cameras: range,
    find: Callable[[VolumePolynomials, float], Sets],
    radius: float,
    least_px: float,
) -> VolumePolynomials:
    """Correct cameras by the sets within a radius that halves every round."""
    for _ in range(_ROUNDS):
        maps, moved = correct(maps, find(maps, radius), cameras)
        if radius <= least_px and moved < _SETTLED_PX:
            break
        radius = max(least_px, 0.5 * radius)
    return maps


def _find_in_camera(
    tracking: Tracking, sure: Sets, camera: int, maps: VolumePolynomials, radius: float
) -> Sets:
    pairs, errors = _pairs(maps, tracking.peaks[camera], camera, sure.positions, radius)
    if not len(pairs):
        raise InputError(
            f"{tracking.cameras[camera].name}: expected particle images within {radius:g} px "
            "of where the other cameras' are, got none"
        )
    return Sets(sure.positions[pairs[:, 0]], pairs, errors[:, None])


def _pairs(
    maps: VolumePolynomials, peaks: Peaks, camera: int, positions: F64, radius: float
) -> tuple[I64, F64]:
    """Return pairs (n, 2) of positions and a camera's images, and errors."""
    pixels = project_points(maps, camera, positions)
    pairs = np.empty((SETS, 2), dtype=np.int64)
    pairs = pairs[: pair_up(peaks, pixels, radius, pairs)]
    return pairs, peaks.pixels[pairs[:, 1]] - pixels[pairs[:, 0]]


def match_particles(
    tracking: Tracking, maps: VolumePolynomials, least_px: float
) -> tuple[F64, F64]:
    """Find particles that the cameras agree on.

    Returns positions (n, 3) from -1 to 1, and pixels (camera, n, 2), NaN where a camera has none.
    A particle image belongs to the set that fits best of all that contain it.
    """
    core = min(_CORE, len(tracking.cameras))
    sets = find_sets(maps, tracking.peaks[:core], least_px)
    order = np.argsort(np.linalg.norm(sets.errors, axis=2).max(axis=1), kind="stable")
    taken: set[tuple[int, int]] = set()
    chosen = []
    for number in order.tolist():
        images = set(enumerate(sets.hits[number].tolist()))
        if taken.isdisjoint(images):
            chosen.append(number)
            taken |= images
    # a random part of them: the best alone would agree with the maps too much
    some = np.random.default_rng(0).permutation(np.array(chosen, dtype=np.int64))[:_MOST]
    positions = sets.positions[some]
    pixels = np.full((len(tracking.cameras), len(some), 2), np.nan)
    for c in range(core):
        pixels[c] = tracking.peaks[c].pixels[sets.hits[some, c]]
    for c in range(core, len(tracking.cameras)):
        pairs, errors = _pairs(maps, tracking.peaks[c], c, positions, least_px)
        farthest_first = np.argsort(-np.linalg.norm(errors, axis=1))
        for row in farthest_first.tolist():  # the nearest comes last and stays
            pixels[c, pairs[row, 0]] = tracking.peaks[c].pixels[pairs[row, 1]]
    return positions, pixels


def adjust_cameras(tracking: Tracking, matched: tuple[F64, F64]) -> tuple[Camera, ...]:
    """Adjust the nominal cameras to particles, in the order of the case.

    A lattice of points that the nominal cameras project, with a standard deviation of two pixels,
    determines what particles do not show.
    """
    (positions, pixels), maps = matched, tracking.maps
    particles = points_in_mm(maps, positions) @ tracking.axes
    nodes = [np.linspace(-1.0, 1.0, count) for count in _LATTICE]
    lattice = points_in_mm(maps, np.array(list(itertools.product(*nodes)))) @ tracking.axes
    points = np.vstack([particles, lattice])
    nominal = np.stack([camera.project(lattice)[0] for camera in tracking.cameras])
    both = np.concatenate([pixels, nominal], axis=1)
    weights = np.isfinite(both).all(axis=2).astype(np.float64)
    frame = WallFrame.from_cameras(tracking.cameras, points[:, None])
    board, world = np.zeros((1, 3)), frame.motion.inverse()
    anchors = tuple(
        Anchor(number, 0, position, np.full(3, 1e6), world)
        for number, position in enumerate(lattice, start=len(particles))
    )
    images = np.nan_to_num(both)[:, :, None], weights[:, :, None]
    views = BoardImages(board, *images, anchors, frame.beyond_kernels)
    state = _adjust(frame.state(board, points[:, None]), views, len(particles))
    by_number = dict(zip(tracking.order, frame.build_cameras(state), strict=True))
    return tuple(by_number[number] for number in range(len(by_number)))


def _adjust(state: State, views: BoardImages, particles: int) -> State:
    """Adjust with Cauchy's loss until the noise falls no more, then by least squares.

    Outliers are left out of the latter, and particles that most cameras see elsewhere. The lattice
    is weighted by its standard deviation.
    """
    noise = _noise(state, views, particles)
    for _ in range(_ROUNDS):
        weighted = replace(views, weights=_weights(views, particles, noise))
        state = refine(state, weighted, FreeParameters(), CAUCHY * noise).state
        before, noise = noise, _noise(state, views, particles)
        if noise > (1.0 - SAME_NOISE) * before:
            break
    weights = _weights(views, particles, noise)
    lengths = np.linalg.norm(residuals(state, views), axis=-1)[:, :particles]
    good = weights[:, :particles]
    # with 4.8 in place of CAUCHY, the error is 1.2 to 1.4 times as large: many images overlap
    good *= lengths <= CAUCHY * noise
    good *= 2 * (good > 0.0).sum(axis=0) > len(good)
    return refine(state, replace(views, weights=weights), FreeParameters()).state


def _weights(views: BoardImages, particles: int, noise: float) -> F64:
    weights = views.weights.copy()
    weights[:, particles:] *= (noise / _NOMINAL_PX) ** 2
    return weights


def _noise(state: State, views: BoardImages, particles: int) -> float:
    lengths = np.linalg.norm(residuals(state, views), axis=-1)[:, :particles]
    return median_noise(lengths[views.weights[:, :particles] > 0.0])
