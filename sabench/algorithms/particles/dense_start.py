"""Start of tracks in images that no single frame can explain.

Where images overlap too much, many particles of a frame are ghosts, and as many are missing. What
is seen in several frames and moves as the flow does is real. What these particles leave of the
images is searched again, in each of the first frames, until no more of them are found.

A ghost does not move as particles around it do, and not for several frames. Each track starts with
the velocity of the flow there, and a Kalman filter predicts it from frame to frame. The velocity
comes from links, many of them wrong: wrong ones scatter over all displacements, right ones
gather where neighbours move. The densest place among the velocities of the nearest links (mean
shift, D. Comaniciu and P. Meer, IEEE Trans. Pattern Anal. Mach. Intell. 24, 603-619, 2002) is that
of the flow. A weighted fit takes out the velocity gradient.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles import kalman_tracks
from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, Known, search_frame
from sabench.algorithms.particles.candidate_search import mean_spacing, pixel_mm
from sabench.algorithms.particles.linking import ALIKE, NEIGHBOURS, link
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.api import Observation
from sabench.geometry.grid import AT_ONCE
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64, I64

# Passes over the first frames:
WINDOW_FRAMES = 6  # frames that are searched together
_GROWTH = 1.1  # of the number of confirmed particles in a pass: after less comes the last pass
_ERROR_PX = 0.25  # of positions where images overlap, far more than they claim
_SOLVED = 0.85  # of links: as many are right if few particles are ghosts

# Tracks through them:
CONFIRMED = 4  # frames in which a real particle was seen
_GAP = 1  # frames in a row that a track may miss
_NEAR = 9.0  # sum of squared misses over the expected ones of what continues a track
_LEAST = 0.1  # of a position's error: the least that accelerations move a particle in an interval
_KNOWN = 2.0  # largest error of a position, over that of a detected one

# Velocity of the flow:
_NEAREST = 60  # links that vote
_WIDTH = 0.15  # scatter of right votes in an interval, over the distance between particles
_LEAST_SPREAD = 0.2  # of that scatter: the least of a velocity
_FITS = 4  # of the densest velocity, and of its gradient
_EVEN = 1e-3, 0.5  # weights of the prior of velocity and its gradient, in votes


def are_mostly_wrong(position: F64, shift: F64) -> bool:
    """Find out whether too few links differ little from those around them.

    Parameters
    ----------
    position, shift : (n, 3) where each link begins and the displacement, in one unit.
    """
    if len(position) <= NEIGHBOURS:
        return False
    distance, near = cKDTree(position).query(position, range(2, NEIGHBOURS + 2))
    apart = np.linalg.norm(shift - np.median(shift[near], axis=1), axis=1)
    alike = apart < ALIKE * np.median(distance[:, 0])
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
    confirmed, last = 0, False
    while not last:
        frames = [search.found() for search in searches if search is not None]
        counts = [len(frame.position_mm) for frame in frames]
        if len(counts) < len(cases) or min(counts) <= NEIGHBOURS:
            return list(alone)
        finds = []
        for frame, time in zip(frames, times_s, strict=True):
            variance = np.asarray(frame.covariance_mm2)[:, [0, 1, 2], [0, 1, 2]]
            # the errors are as large as where images overlap
            usual = np.median(variance, axis=0)
            usual *= (_ERROR_PX * pixel_mm(maps)) ** 2 / usual.min()
            errors = np.broadcast_to(usual, variance.shape)
            finds.append(Finds(time, frame.position_mm, errors, np.asarray(frame.light)))
        real = confirm_tracks(finds, mean_spacing(maps, float(np.mean(counts))))
        before, confirmed = confirmed, sum(len(frame.position) for frame in real)
        if not confirmed:
            return list(alone)
        last = confirmed < _GROWTH * before
        few = len(alone) if last else len(cases)
        searches = [
            search_frame(case, maps, settings, sure)
            for case, sure in zip(cases[:few], real[:few], strict=True)
        ]
    first = [search for search in searches if search is not None]
    return first if len(first) == len(alone) else list(alone)


class Finds(NamedTuple):
    """Particles of a frame: time, s, positions, variances (n, 3), light (n, camera)."""

    time: float
    position: F64
    variance: F64
    light: F64


def confirm_tracks(frames: Sequence[Finds], spacing: float) -> list[Known]:
    """Find out which particles are real, and where they are in each frame.

    Parameters
    ----------
    frames : at least as many as confirm a track.
    spacing : distance between particles, mm.
    """
    votes = collect_votes([frame.position for frame in frames], [frame.time for frame in frames])
    flow = [estimate_velocity(votes, frame.position, spacing) for frame in frames]
    least = _LEAST * float(np.sqrt(frames[0].variance.min())) / votes.interval**2
    tracks = kalman_tracks.start_tracks(frames[0].position, flow[0][0], votes.longest, least)
    motion = tracks.acceleration, tracks.jerk
    number = _number_tracks(frames, flow, tracks)
    real = np.flatnonzero(np.bincount(np.concatenate(number)) >= CONFIRMED)
    values = ((*frame[1:], *moves) for frame, moves in zip(frames, flow, strict=True))
    position, variance, light, velocity, spread = (
        kalman_tracks.values_of_tracks(real, number, each) for each in zip(*values, strict=True)
    )
    expected = np.nanmean(velocity, axis=1), np.nanmean(spread, axis=1)
    typical = np.nanmedian(light, axis=1)
    confirmed = []
    for frame in frames:
        times = np.array([other.time - frame.time for other in frames])
        state, errors = kalman_tracks.most_probable_motion(
            times, position, variance, *expected, *motion
        )
        usual = np.sqrt(np.median(frame.variance, axis=0))
        good = np.median(np.sqrt(errors[:, :, 0, 0]) / usual, axis=1) < _KNOWN
        confirmed.append(Known(state[good, 0], typical[good]))
    return confirmed


def _number_tracks(
    frames: Sequence[Finds], flow: Sequence[tuple[F64, F64]], tracks: kalman_tracks.KalmanTracks
) -> list[I64]:
    """Follow particles through the frames by the flow; return tracks (n,)."""
    motion, numbers = (tracks.acceleration, tracks.jerk), []
    born, last = 0, frames[0].time
    for frame, (velocity, spread) in zip(frames, flow, strict=True):
        number = np.full(len(frame.position), -1)
        if len(tracks.number):
            tracks.predict(frame.time - last)
            every = np.arange(len(tracks.number))
            rows, hits = tracks.pair(every, frame.position, frame.variance, NEIGHBOURS, _NEAR)
            number[hits] = tracks.number[rows]
            tracks.update(rows, frame.position[hits], frame.variance[hits], frame.light[hits])
            tracks.acceleration, tracks.jerk = motion
            tracks.select((tracks.missed <= _GAP) & ((tracks.sightings > 1) | (tracks.missed == 0)))
        new = np.flatnonzero(number < 0)
        number[new] = born + np.arange(len(new))
        begun = frame.position[new], frame.variance[new], frame.light[new]
        tracks.add(number[new], *begun, velocity[new], spread[new], 1)
        born, last = born + len(new), frame.time
        numbers.append(number)
    return numbers


class LinkVotes(NamedTuple):
    """Links between frames.

    Attributes
    ----------
    position, velocity : middle (n, 3) of each, mm, and velocity (n, 3), mm/s.
    interval, longest : between two frames, s: the usual and the longest one.
    """

    position: F64
    velocity: F64
    interval: float
    longest: float


def collect_votes(position: Sequence[F64], times_s: Sequence[float]) -> LinkVotes:
    """Link the particles (n, 3) of each frame to those of the next one."""
    votes = []
    for early, late, start, end in zip(position, position[1:], times_s, times_s[1:], strict=False):
        numbers = link([early, late], [np.ones(len(early)), np.ones(len(late))], [start, end])
        _, i, j = np.intersect1d(numbers[0], numbers[1], return_indices=True)
        middle, shift = (early[i] + late[j]) / 2.0, late[j] - early[i]
        votes.append((middle, shift / (end - start)))
    places, velocities = (np.concatenate(parts) for parts in zip(*votes, strict=True))
    between = np.diff(times_s)
    return LinkVotes(places, velocities, float(np.median(between)), float(between.max()))


def estimate_velocity(votes: LinkVotes, position: F64, spacing: float) -> tuple[F64, F64]:
    """Estimate velocities (n, 3) at positions (n, 3), mm, and their variances.

    `spacing` is the distance between particles, mm.
    """
    place, velocity = votes.position, votes.velocity
    if not len(place):
        return np.zeros_like(position), np.full_like(position, kalman_tracks.ANY_SPEED**2)
    count = min(_NEAREST, len(place))
    _, rows = cKDTree(place).query(position, range(1, count + 1))
    width = _WIDTH * spacing / votes.interval
    parts = []
    at_once = max(1, AT_ONCE // count**2)
    for first in range(0, len(position), at_once):
        part, here = rows[first : first + at_once], position[first : first + at_once]
        parts.append(_fit(velocity[part], (place[part] - here[:, None]) / spacing, width))
    none = np.zeros((0, 3))
    means, spreads = zip((none, none), *parts, strict=True)
    return np.concatenate(means), np.maximum(np.concatenate(spreads), (_LEAST_SPREAD * width) ** 2)


def _fit(velocity: F64, away: F64, width: float) -> tuple[F64, F64]:
    """Find the densest velocity (n, 3) of votes (n, k, 3) that are away (n, k, 3)."""
    squares = np.sum(np.square(velocity), axis=2)
    apart = squares[:, :, None] + squares[:, None] - 2.0 * velocity @ velocity.transpose(0, 2, 1)
    densest = np.exp(-0.5 * apart / width**2).sum(axis=2).argmax(axis=1)
    middle = velocity[np.arange(len(velocity)), densest]
    for _ in range(_FITS):
        weight = _weigh(velocity - middle[:, None], width)
        middle = np.einsum("nk,nka->na", weight, velocity) / weight.sum(axis=1)[:, None]
    terms = np.concatenate([np.ones((*away.shape[:2], 1)), away], axis=2)
    prior = np.diag([_EVEN[0], *[_EVEN[1]] * 3])
    fitted = np.repeat(middle[:, None], velocity.shape[1], axis=1)
    for _ in range(_FITS):
        weight = _weigh(velocity - fitted, width)
        matrix = np.einsum("nkp,nk,nkq->npq", terms, weight, terms) + prior
        right = np.einsum("nkp,nk,nka->npa", terms, weight, velocity - middle[:, None])
        change = np.linalg.solve(matrix, right)
        fitted = middle[:, None] + terms @ change
    spread = np.einsum("nk,nka->na", weight, np.square(velocity - fitted))
    return middle + change[:, 0], spread / weight.sum(axis=1)[:, None]


def _weigh(misses: F64, width: float) -> F64:
    return np.asarray(np.exp(-0.5 * np.sum(np.square(misses), axis=2) / width**2)) + 1e-12
