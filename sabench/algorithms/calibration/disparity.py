"""Errors of cameras from sets of particle images that are mostly wrong.

The right ones agree, the wrong ones scatter.

Source: B. Wieneke, Exp. Fluids 45, 549-556, 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.algorithms.particles.correspondence import follow_lines, match
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.images.peaks import Peaks
from sabench.utils.arrays import F64, I64

_CELL_PX = 1.0  # in which sets are counted
_SPOT_PX = 0.6  # radius of what belongs together
_AROUND_PX = 1.5  # as far as a search for the middle of a spot goes
_TRIED, _SHIFTS = 20, 10
_SETS = 1_000_000
_STEP_PX = 1.5  # between positions on a line of sight, as the other cameras see them
_PARTS = 3  # of the box along x and along y, each with a disparity of its own
_FEW = 100  # sets below which a part has none


@dataclass(frozen=True)
class Sets:
    """Sets of particle images.

    Places (n, 3) from -1 to 1 in the box, numbers (n, cameras) of the images, errors (n, cameras,
    2) in px.
    """

    positions: F64
    hits: I64
    errors: F64


def find_sets(maps: VolumePolynomials, peaks: tuple[Peaks, ...], reach_px: float) -> Sets:
    """Find sets of peaks within a radius, and the errors of their images.

    Errors are distances from the projections of the position that fits best.

    If they are too many, they are those of a random part of the first camera's images.
    The shares of right and wrong sets then stay the same.
    """
    along, steps = follow_lines(maps, range(len(peaks)), _STEP_PX)
    positions, hits, errors = (
        np.empty((_SETS, 3)),
        np.empty((_SETS, len(peaks)), dtype=np.int32),
        np.empty((_SETS, len(peaks), 2)),
    )
    order = np.random.default_rng(0).permutation(len(peaks[0].pixels))
    count = match(maps, peaks, order, reach_px, along, steps, positions, hits, errors)
    return Sets(positions[:count].copy(), hits[:count].astype(np.int64), errors[:count].copy())


def correct(maps: VolumePolynomials, sets: Sets, cameras: range) -> tuple[VolumePolynomials, float]:
    """Move the polynomials of these cameras by their common disparity.

    Also returns the largest move in px.

    All cameras' errors together are one vector, from which the part that a change of position
    explains is projected out. In the few dimensions that are left, the right sets lie in one spot
    and the wrong ones scatter. Every part of the box with enough sets near that spot has a
    disparity of its own; a plane is fitted to these.
    """
    basis = _unobservable_shifts(maps, cameras)
    errors = sets.errors.reshape(len(sets.errors), -1) @ basis
    whole = densest(errors)
    rows, spots = _by_parts(sets.positions, errors, whole)
    shifts = (spots @ basis.T).reshape(len(spots), len(cameras), 2)
    coefficients, most = maps.coefficients.copy(), 0.0
    terms = [
        int(np.flatnonzero((maps.powers == powers).all(axis=1))[0])
        for powers in ((0, 0, 0), (1, 0, 0), (0, 1, 0))
    ]
    for number, camera in enumerate(cameras):
        plane = np.linalg.lstsq(rows, shifts[:, number], rcond=None)[0]
        for term, move in zip(terms, plane, strict=False):
            coefficients[camera, term] += move
        most = max(most, float(np.linalg.norm(rows @ plane, axis=1).max()))
    return maps._replace(coefficients=coefficients), most


def densest(values: F64) -> F64:
    """Find the middle (d,) of the most crowded spot of values (n, d)."""
    cells = np.floor(values / _CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0)
    keys = np.ravel_multi_index(tuple(cells.T), tuple((cells.max(axis=0) + 1).tolist()))
    found, counts = np.unique(keys, return_counts=True)
    best, most = np.asarray(values.mean(axis=0), dtype=np.float64), -1
    for key in found[np.argsort(-counts, kind="stable")[:_TRIED]]:
        start = values[keys == key].mean(axis=0)
        near = values[(np.abs(values - start) <= _AROUND_PX).all(axis=1)]
        middle, count = _shift_mean(near, start)
        if count > most:
            best, most = middle, count
    return best


def _shift_mean(values: F64, middle: F64) -> tuple[F64, int]:
    """Compute the mean of the values near a point, then near that mean, and so on.

    Also returns the number of these values.
    """
    near = np.zeros(len(values), dtype=np.bool_)
    for _ in range(_SHIFTS):
        near = np.linalg.norm(values - middle, axis=1) <= _SPOT_PX
        if not near.any():
            break
        middle = values[near].mean(axis=0)
    return middle, int(near.sum())


def _unobservable_shifts(maps: VolumePolynomials, cameras: range) -> F64:
    """Compute orthonormal columns (2 cameras, d).

    They span the changes of the cameras' pixels that no change of position causes, at the middle of
    the box. For one camera they span all changes.
    """
    if len(cameras) < 2:
        return np.eye(2)
    nearby = 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    pixels = np.stack([project_points(maps, camera, nearby) for camera in cameras])
    slopes = (pixels[:, :3] - pixels[:, 3:]).transpose(0, 2, 1).reshape(-1, 3)
    return np.asarray(np.linalg.svd(slopes)[0][:, 3:])


def _by_parts(positions: F64, errors: F64, whole: F64) -> tuple[F64, F64]:
    """Compute rows (1, x, y) of the middles of the parts, and their spots.

    One row (1,) for the whole box where parts have too few.
    """
    near = np.linalg.norm(errors - whole, axis=1) <= 2.0 * _SPOT_PX
    part = np.clip(((positions[:, :2] + 1.0) / 2.0 * _PARTS).astype(int), 0, _PARTS - 1) @ [
        1,
        _PARTS,
    ]
    chosen = [np.flatnonzero(near & (part == number)) for number in range(_PARTS**2)]
    if min(len(own) for own in chosen) < _FEW:
        return np.ones((1, 1)), whole[None]
    middles = np.array([positions[own, :2].mean(axis=0) for own in chosen])
    return np.column_stack([np.ones(len(chosen)), middles]), np.stack(
        [_shift_mean(errors[own], whole)[0] for own in chosen]
    )
