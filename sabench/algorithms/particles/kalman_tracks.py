"""Tracks of particles: predictions, and the most probable motion in each frame.

A Kalman filter for each particle and axis has position, velocity and acceleration, which a random
jerk changes (Y. Bar-Shalom et al., Estimation with applications to tracking and navigation, Wiley
2001, section 6.2). The errors of positions come from the images; the strength of the jerk, and how
much particles accelerate at first, come from the misses of the predictions themselves.

The motion in a frame follows from a track's positions before and after by generalised least
squares, as a fixed-lag smoother would find it (sections 6.2 and 8.6 there): the positions are those
of a body with white-noise jerk, each with an error of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.linking import ENOUGH, NEIGHBOURS, assign
from sabench.algorithms.particles.particle_search import joined
from sabench.api import FoundParticles
from sabench.utils.arrays import F64, FROM_MAD, I64, Bool

MATURE = 3  # positions after which a track's own prediction is as good as it gets
_SURPRISE = 12.0  # sum of three squared misses over the expected ones, seldom reached
# of the first strength of the jerk, at least: a product that has become 0 stays 0
_LEAST = 1e-6
_BY_TRACK = ("number", "state", "covariance", "light", "sightings", "missed")
ANY_SPEED = 1e6  # mm/s
# first guesses of acceleration over velocity times velocity gradient, and of its change over itself
# times gradient times time: those of turbulence, within a few percent for two integral lengths
_ACCELERATION, _CHANGE = 1.4, 3.5
_ABSENT = 1e12  # variance of a missing position, over the largest other one


@dataclass
class KalmanTracks:
    """Tracks that may go on, all predicted to the same time.

    Attributes
    ----------
    number : (n,) of the trajectories.
    state : (n, 3, 3) position, velocity and acceleration along the axes, mm and s.
    covariance : (n, 3, 3, 3) of these three, for each axis.
    light : (n, camera) last seen.
    sightings : (n,) how many positions a track has.
    missed : (n,) predictions since the last of them.
    jerk, least_jerk : power of the jerk, mm2/s5.
    acceleration : variance of a new track's acceleration, mm2/s4.
    """

    number: I64
    state: F64
    covariance: F64
    light: F64
    sightings: I64
    missed: I64
    jerk: float
    acceleration: float
    least_jerk: float

    @staticmethod
    def start(acceleration: float, jerk: float) -> KalmanTracks:
        """Begin without tracks, with first guesses of the strengths."""
        none = np.zeros(0, dtype=np.int64)
        tracks = none, np.zeros((0, 3, 3)), np.zeros((0, 3, 3, 3)), np.zeros((0, 0)), none, none
        return KalmanTracks(*tracks, jerk, acceleration, _LEAST * jerk)

    @property
    def variance(self) -> F64:
        """Variances (n, 3) of the positions."""
        return np.asarray(self.covariance[:, :, 0, 0])

    def select(self, rows: Bool | I64) -> None:
        """Keep these tracks."""
        for name in _BY_TRACK:
            setattr(self, name, getattr(self, name)[rows])

    def predict(self, duration: float) -> None:
        """Move the states on by a duration in s."""
        d = duration
        step = np.array([[1.0, d, d**2 / 2.0], [0.0, 1.0, d], [0.0, 0.0, 1.0]])
        rows = [d**5 / 20.0, d**4 / 8.0, d**3 / 6.0], [d**4 / 8.0, d**3 / 3.0, d**2 / 2.0]
        noise = np.array([*rows, [d**3 / 6.0, d**2 / 2.0, d]])
        self.state = step @ self.state
        self.covariance = step @ self.covariance @ step.T + self.jerk * noise
        self.missed = self.missed + 1

    def off(self, rows: I64, position: F64, variance: F64) -> F64:
        """Compute squared misses (n, 3) of positions over what is expected."""
        expected = self.covariance[rows][:, :, 0, 0] + variance
        return np.asarray((position - self.state[rows, 0]) ** 2 / expected)

    def pair(
        self, rows: I64, position: F64, variance: F64, few: int, most: float
    ) -> tuple[I64, I64]:
        """Pair tracks (rows) with positions, one to one, by misses.

        The square sum of a pair's misses is below `most`. Each track has the `few` nearest
        positions as candidates.
        """
        count = min(few, len(position))
        if not count or not len(rows):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        _, slot = cKDTree(position).query(self.state[rows, 0], range(1, count + 1))
        i, j = np.repeat(np.arange(len(rows)), count), slot.ravel()
        cost = self.off(rows[i], position[j], variance[j]).sum(axis=1)
        good = cost < most
        i, j = assign(i[good], j[good], cost[good], (len(rows), len(position)))
        return rows[i], j

    def update(self, rows: I64, position: F64, variance: F64, light: F64) -> None:
        """Update tracks by positions (n, 3), their variances, and light (n, camera).

        The strengths of jerk and acceleration follow the misses. The errors of a track that misses
        by more than expected grow: its acceleration is not known.
        """
        off = self.off(rows, position, variance)
        last = self.missed[rows] == 1
        old, new = self.sightings[rows] >= MATURE, self.sightings[rows] == MATURE - 1
        if (last & old).sum() >= ENOUGH:
            self.jerk = max(self.jerk * _change(off[last & old]), self.least_jerk)
        if (last & new).sum() >= ENOUGH:
            self.acceleration *= _change(off[last & new])
        covariance = self.covariance[rows]
        covariance *= np.maximum(off.sum(axis=1) / _SURPRISE, 1.0)[:, None, None, None]
        gain = covariance[:, :, :, 0] / (covariance[:, :, 0, 0] + variance)[:, :, None]
        miss = position - self.state[rows, 0]
        self.state[rows] += (gain * miss[:, :, None]).transpose(0, 2, 1)
        self.covariance[rows] = covariance - gain[:, :, :, None] * covariance[:, :, None, 0, :]
        self.light[rows] = light
        self.sightings[rows] += 1
        self.missed[rows] = 0

    def neighbours_velocity(self, position: F64) -> tuple[F64, F64]:
        """Estimate velocities (n, 3) and their variances from tracks near, if any."""
        followed = (self.sightings >= 2) & (self.missed == 0)
        return velocity_near(position, self.state[followed, 0], self.state[followed, 1])

    def add(
        self,
        number: I64,
        position: F64,
        variance: F64,
        light: F64,
        velocity: F64,
        spread: F64,
        sightings: int,
    ) -> None:
        """Begin tracks that have so many positions.

        Positions (n, 3), mm, and velocities, mm/s, have variances, the latter `spread`.
        """
        count = len(number)
        state = np.stack([position, velocity, np.zeros((count, 3))], axis=1)
        covariance = np.zeros((count, 3, 3, 3))
        covariance[:, :, 0, 0], covariance[:, :, 1, 1] = variance, spread
        covariance[:, :, 2, 2] = self.acceleration
        times = np.full(count, sightings), np.zeros(count, dtype=np.int64)
        new = (number, state, covariance, light, *times)
        for name, more in zip(_BY_TRACK, new, strict=True):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, more]) if len(old) else more)


def start_tracks(position: F64, velocity: F64, longest_s: float, least: float) -> KalmanTracks:
    """Guess how strongly particles accelerate, and how fast that changes.

    An acceleration is as large as (u grad) u, of fluctuations of the velocity and their gradient,
    but at least `least`. A random jerk changes it as much in the longest time between two frames.
    """
    distance, near = cKDTree(position).query(position, NEIGHBOURS + 1)
    apart = np.linalg.norm(velocity[near[:, 1:]] - velocity[:, None], axis=2)
    gradient = float(np.median(apart / np.maximum(distance[:, 1:], 1e-12)))
    fluctuation = FROM_MAD * np.median(np.abs(velocity - np.median(velocity, axis=0)), axis=0)
    acceleration = max(_ACCELERATION * gradient * float(np.sqrt(np.mean(fluctuation**2))), least)
    change = min(_CHANGE * gradient * longest_s, math.sqrt(2.0))  # unrelated ones differ so much
    return KalmanTracks.start(acceleration**2, (change * acceleration) ** 2 / longest_s)


def velocity_near(position: F64, neighbours: F64, velocity: F64) -> tuple[F64, F64]:
    """Estimate velocities (n, 3) and variances from known ones (m, 3); 0 without any."""
    if not len(neighbours):
        return np.zeros_like(position), np.full_like(position, ANY_SPEED**2)
    count = min(NEIGHBOURS, len(neighbours))
    _, near = cKDTree(neighbours).query(position, range(1, count + 1))
    around = velocity[near]
    spread = around.var(axis=1) * (1.0 + 2.0 / NEIGHBOURS)
    if count < 2:
        spread = np.full_like(position, ANY_SPEED**2)
    return np.median(around, axis=1), spread


def _change(off: F64) -> float:
    return FROM_MAD**2 * float(np.median(off))


def most_probable_motion(
    times: F64,
    position: F64,
    variance: F64,
    velocity: F64,
    spread: F64,
    acceleration: float,
    jerk: float,
) -> tuple[F64, F64]:
    """Estimate the motion at time 0, along each axis on its own.

    Parameters
    ----------
    times : (m,) s.
    position, variance : (n, m, 3) mm, mm2; NaN where a track has no position.
    velocity, spread : (n, 3) what is known of velocities without the positions, mm/s, and its
        variance.
    acceleration : variance of accelerations, mm2/s4, around 0.
    jerk : power of the jerk, mm2/s5.

    Returns
    -------
    (n, 3, 3) the three along each axis, orders before axes; their covariances (n, 3, 3, 3), axes
    first.
    """
    unit = float(np.abs(times).max(initial=0.0)) or 1.0  # of time, so that nothing is lost
    times, jerk = times / unit, jerk * unit**5
    observed = np.isfinite(position) & np.isfinite(variance)
    largest = float(variance[observed].max(initial=0.0)) + jerk
    noise = np.where(observed, variance, _ABSENT * max(largest, 1e-300)).transpose(0, 2, 1)
    terms = np.stack([np.ones_like(times), times, times**2 / 2.0], axis=1)
    covariance = jerk * _jerk_covariance(times) + noise[:, :, :, None] * np.eye(len(times))
    weighed = np.linalg.solve(covariance, np.broadcast_to(terms, (*noise.shape[:2], *terms.shape)))
    matrix = np.einsum("mp,namq->napq", terms, weighed)
    right = np.einsum("namp,nam->nap", weighed, np.nan_to_num(position).transpose(0, 2, 1))
    matrix[:, :, 1, 1] += 1.0 / (spread * unit**2)
    right[:, :, 1] += velocity / (spread * unit)
    matrix[:, :, 2, 2] += 1.0 / (acceleration * unit**4)
    posterior = np.linalg.inv(matrix)
    state = np.einsum("napq,naq->npa", posterior, right)
    back = unit ** -np.arange(3.0)
    return state * back[:, None], posterior * np.outer(back, back)


def _jerk_covariance(times: F64) -> F64:
    """Compute the covariance (m, m) of positions by a jerk of power 1 since time 0.

    Jerks before and after are independent. Until a time t the position grows with (t - s)^2 / 2:
    two times on one side share the integral of both such squares.
    """
    time, other = np.abs(times)[:, None], np.abs(times)[None, :]
    least, rest = np.minimum(time, other), np.abs(time - other)
    both = least**5 / 20.0 + rest * least**4 / 8.0 + rest**2 * least**3 / 12.0
    return np.where(times[:, None] * times[None, :] > 0.0, both, 0.0)


@dataclass
class TrackedFrame:
    """Particles of a frame, their trajectories (n,), and whether they were seen."""

    time: float
    particles: FoundParticles
    number: I64
    detected: Bool

    @property
    def position(self) -> F64:
        """Positions (n, 3), mm."""
        return self.particles.position_mm

    @property
    def variance(self) -> F64:
        """Variances (n, 3) of positions, mm2."""
        return np.asarray(self.particles.covariance_mm2)[:, [0, 1, 2], [0, 1, 2]]

    def add(self, more: FoundParticles, number: I64) -> None:
        """Add particles that were not seen."""
        self.particles = joined(self.particles, more)
        self.number = np.concatenate([self.number, number])
        self.detected = np.concatenate([self.detected, np.zeros(len(number), dtype=np.bool_)])

    def drop(self, ghosts: I64) -> None:
        """Drop some trajectories."""
        remaining = ~np.isin(self.number, ghosts)
        self.particles, self.number = self.particles.rows(remaining), self.number[remaining]
        self.detected = self.detected[remaining]


def with_motion(
    frames: Sequence[TrackedFrame], frame: TrackedFrame, motion: tuple[float, float] | None
) -> FoundParticles:
    """Add velocities, accelerations and positions where none was seen to a frame."""
    particles = replace(frame.particles, trajectory=frame.number)
    if motion is None or not len(frame.number):
        return particles
    times = np.array([other.time - frame.time for other in frames])
    seen = [(f.number[f.detected], f.position[f.detected], f.variance[f.detected]) for f in frames]
    numbers, *values = zip(*seen, strict=True)
    position, variance = (values_of_tracks(frame.number, numbers, each) for each in values)
    moving = np.isfinite(position[:, :, 0]).sum(axis=1) > 1
    still = np.zeros_like(frame.position), np.full_like(frame.position, ANY_SPEED**2)
    state, _ = most_probable_motion(times, position, variance, *still, *motion)
    expected = velocity_near(frame.position, frame.position[moving], state[moving, 1])
    state, covariance = most_probable_motion(times, position, variance, *expected, *motion)
    shown = frame.detected[:, None]
    place = np.where(shown, frame.position, state[:, 0])
    error = np.where(shown[:, None], np.asarray(particles.covariance_mm2), _diagonal(covariance, 0))
    return replace(
        particles,
        position_mm=place,
        covariance_mm2=error,
        velocity_mm_s=state[:, 1],
        acceleration_mm_s2=state[:, 2],
        velocity_covariance=_diagonal(covariance, 1),
        acceleration_covariance=_diagonal(covariance, 2),
    )


def values_of_tracks(tracks: I64, number: Sequence[I64], values: Sequence[F64]) -> F64:
    """Collect values (n, k) of tracks (m,): (m, frame, k), NaN for nothing."""
    table = np.full((len(tracks), len(number), values[0].shape[1]), np.nan)
    for slot, (numbers, rows) in enumerate(zip(number, values, strict=True)):
        _, i, j = np.intersect1d(tracks, numbers, return_indices=True)
        table[i, slot] = rows[j]
    return table


def _diagonal(covariance: F64, order: int) -> F64:
    return np.asarray(covariance[:, :, order, order, None] * np.eye(3))
