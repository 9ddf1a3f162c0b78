"""Tracks of particles through a few frames in which many are ghosts or missing.

A ghost does not move as particles around it do, and not for several frames. Each track starts with
the velocity of the flow there, and a Kalman filter predicts it from frame to frame. What is seen in
several frames is taken for real, and where it was in each of them follows from all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sabench.algorithms.particles.bayesian_ipr import Known
from sabench.algorithms.particles.kalman_tracks import KalmanTracks, start_tracks
from sabench.algorithms.particles.linking import assign
from sabench.algorithms.particles.local_velocity import collect_votes, estimate_velocity
from sabench.algorithms.particles.track_motion import most_probable_motion
from sabench.utils.arrays import F64, I64

CONFIRMED = 4  # frames in which a real particle was seen
_GAP = 1  # frames in a row that a track may miss
_NEAR = 9.0  # sum of squared misses over the expected ones of what continues a track
_FEW = 6  # particles that may continue a track
_LEAST = 0.1  # of a position's error: the least that accelerations move a particle in an interval
_KNOWN = 2.0  # error of a position that is worth taking, over that of one found


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
    votes = collect_votes([one.position for one in frames], [one.time for one in frames])
    flow = [estimate_velocity(votes, one.position, one.time, spacing) for one in frames]
    least = _LEAST * float(np.sqrt(frames[0].variance.min())) / votes.interval**2
    tracks = start_tracks(frames[0].position, flow[0][0], votes.longest, least)
    motion = tracks.acceleration, tracks.jerk
    number = _number_tracks(frames, flow, tracks)
    real = np.flatnonzero(np.bincount(np.concatenate(number)) >= CONFIRMED)
    position, variance, light, velocity, spread = (
        _table(real, number, values)
        for values in zip(
            *((*one[1:], *moves) for one, moves in zip(frames, flow, strict=True)), strict=True
        )
    )
    expected = np.nanmean(velocity, axis=1), np.nanmean(spread, axis=1)
    typical = np.nanmedian(light, axis=1)
    known = []
    for frame in frames:
        times = np.array([one.time - frame.time for one in frames])
        state, errors = most_probable_motion(times, position, variance, *expected, *motion)
        usual = np.sqrt(np.median(frame.variance, axis=0))
        good = np.median(np.sqrt(errors[:, :, 0, 0]) / usual, axis=1) < _KNOWN
        known.append(Known(state[good, 0], typical[good]))
    return known


def _table(real: I64, number: Sequence[I64], values: Sequence[F64]) -> F64:
    """Collect values (n, k) of tracks (m,): (m, frame, k), NaN for nothing."""
    table = np.full((len(real), len(number), values[0].shape[1]), np.nan)
    for slot, (numbers, rows) in enumerate(zip(number, values, strict=True)):
        _, i, j = np.intersect1d(real, numbers, return_indices=True)
        table[i, slot] = rows[j]
    return table


def _number_tracks(
    frames: Sequence[Finds], flow: Sequence[tuple[F64, F64]], tracks: KalmanTracks
) -> list[I64]:
    """Follow particles through the frames, and return the track (n,) of each.

    Tracks start with the velocities of the flow and their variances. What few of them tell does not
    change how strongly particles accelerate.
    """
    motion, numbers = (tracks.acceleration, tracks.jerk), []
    born, last = 0, frames[0].time
    for frame, (velocity, spread) in zip(frames, flow, strict=True):
        number = np.full(len(frame.position), -1)
        if len(tracks.number):
            tracks.predict(frame.time - last)
            rows, seen = _continue(tracks, frame)
            number[seen] = tracks.number[rows]
            tracks.update(rows, frame.position[seen], frame.variance[seen], frame.light[seen])
            tracks.acceleration, tracks.jerk = motion
            tracks.select((tracks.missed <= _GAP) & ((tracks.seen > 1) | (tracks.missed == 0)))
        new = np.flatnonzero(number < 0)
        number[new] = born + np.arange(len(new))
        begun = frame.position[new], frame.variance[new], frame.light[new]
        tracks.add(number[new], *begun, velocity[new], spread[new], 1)
        born, last = born + len(new), frame.time
        numbers.append(number)
    return numbers


def _continue(tracks: KalmanTracks, frame: Finds) -> tuple[I64, I64]:
    """Pair tracks with the particles of a frame."""
    count = min(_FEW, len(frame.position))
    if not count:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    _, slot = cKDTree(frame.position).query(tracks.state[:, 0], range(1, count + 1))
    i, j = np.repeat(np.arange(len(tracks.number)), count), slot.ravel()
    cost = tracks.off(i, frame.position[j], frame.variance[j]).sum(axis=1)
    good = cost < _NEAR
    return assign(i[good], j[good], cost[good], (len(tracks.number), len(frame.position)))
