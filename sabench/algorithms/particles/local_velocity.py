"""Velocities of a flow from links of which many are wrong.

Wrong links scatter over all displacements, right ones gather where neighbours move: the densest
place among the velocities of the nearest links (mean shift, D. Comaniciu and P. Meer, IEEE Trans.
Pattern Anal. Mach. Intell. 24, 603-619, 2002) is that of the flow. A weighted fit takes out the
velocity gradient.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.kalman_tracks import ANY_SPEED
from sabench.algorithms.particles.linking import link
from sabench.utils.arrays import F64

_NEAREST = 60  # links that vote
_FRAMES = 2.6  # longest time between a link and where its vote counts, over that between frames
_WIDTH = 0.15  # scatter of right votes in an interval, over the distance between particles
_LEAST = 0.2  # of that scatter: the least of a velocity
_SHIFTS, _FITS = 5, 3
_EVEN = 1e-3, 0.5  # what is known of velocity and its gradient beforehand, in votes
_PORTION = 4096  # positions in one step, for the memory


class Votes(NamedTuple):
    """Links between frames.

    Attributes
    ----------
    position, velocity, time : middle (n, 3) of each, mm, velocity (n, 3), mm/s, and time (n,), s.
    interval, longest : between two frames, s: the usual and the longest one.
    """

    position: F64
    velocity: F64
    time: F64
    interval: float
    longest: float


def collect_votes(position: Sequence[F64], times_s: Sequence[float]) -> Votes:
    """Link the particles (n, 3) of each frame to those of the next one."""
    votes = []
    for one, other, start, end in zip(position, position[1:], times_s, times_s[1:], strict=False):
        numbers = link([one, other], [np.ones(len(one)), np.ones(len(other))], [start, end])
        _, i, j = np.intersect1d(numbers[0], numbers[1], return_indices=True)
        middle, shift = (one[i] + other[j]) / 2.0, other[j] - one[i]
        time = np.full(len(i), (start + end) / 2.0)
        votes.append((middle, shift / (end - start), time))
    places, velocities, times = (np.concatenate(parts) for parts in zip(*votes, strict=True))
    between = np.diff(times_s)
    return Votes(places, velocities, times, float(np.median(between)), float(between.max()))


def estimate_velocity(votes: Votes, position: F64, time: float, spacing: float) -> tuple[F64, F64]:
    """Estimate velocities (n, 3) at positions (n, 3), and their variances.

    Parameters
    ----------
    time : of the positions, s.
    spacing : distance between particles, mm.
    """
    near = np.abs(votes.time - time) <= _FRAMES * votes.longest
    place, velocity = votes.position[near], votes.velocity[near]
    if not len(place):
        return np.zeros_like(position), np.full_like(position, ANY_SPEED**2)
    count = min(_NEAREST, len(place))
    _, rows = cKDTree(place).query(position, range(1, count + 1))
    width = _WIDTH * spacing / votes.interval
    parts = [
        _fit(velocity[part], (place[part] - here[:, None]) / spacing, width)
        for part, here in (
            (rows[first : first + _PORTION], position[first : first + _PORTION])
            for first in range(0, len(position), _PORTION)
        )
    ]
    none = np.zeros((0, 3))
    means, spreads = zip((none, none), *parts, strict=True)
    return np.concatenate(means), np.maximum(np.concatenate(spreads), (_LEAST * width) ** 2)


def _fit(velocity: F64, away: F64, width: float) -> tuple[F64, F64]:
    """Find the densest velocity (n, 3) of votes (n, k, 3) that are away (n, k, 3)."""
    squares = np.sum(np.square(velocity), axis=2)
    apart = squares[:, :, None] + squares[:, None] - 2.0 * velocity @ velocity.transpose(0, 2, 1)
    densest = np.exp(-0.5 * apart / width**2).sum(axis=2).argmax(axis=1)
    middle = velocity[np.arange(len(velocity)), densest]
    for _ in range(_SHIFTS):
        weight = _weigh(velocity - middle[:, None], width)
        middle = np.einsum("nk,nka->na", weight, velocity) / weight.sum(axis=1)[:, None]
    terms = np.concatenate([np.ones((*away.shape[:2], 1)), away], axis=2)
    known = np.diag([_EVEN[0], *[_EVEN[1]] * 3])
    fitted = np.repeat(middle[:, None], velocity.shape[1], axis=1)
    for _ in range(_FITS):
        weight = _weigh(velocity - fitted, width)
        matrix = np.einsum("nkp,nk,nkq->npq", terms, weight, terms) + known
        right = np.einsum("nkp,nk,nka->npa", terms, weight, velocity - middle[:, None])
        change = np.linalg.solve(matrix, right)
        fitted = middle[:, None] + terms @ change
    spread = np.einsum("nk,nka->na", weight, np.square(velocity - fitted))
    return middle + change[:, 0], spread / weight.sum(axis=1)[:, None]


def _weigh(misses: F64, width: float) -> F64:
    return np.asarray(np.exp(-0.5 * np.sum(np.square(misses), axis=2) / width**2)) + 1e-12
