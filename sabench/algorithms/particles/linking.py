"""Linking of bubbles that were detected frame by frame to trajectories.

Each trajectory has a prediction; detections near predictions are assigned one to one.

The assignment is that of Jaqaman et al. (Nature Methods 5, 695, 2008): links have costs, and so
have trajectories without a link; the sum is minimal. A trajectory of two detections or more is
predicted by its last velocity. One of a single detection is predicted by its neighbours: the more
of them find a detection after the same displacement, or are known to move so, the less its link
costs (relaxation, after Baek and Lee, Exp. Fluids 22, 23, 1996). This separates two streams through
each other. Limit: bubbles that move at random, and not like their neighbours, are tracked only
while they move by less than a third of the distance between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree

from sabench.utils.arrays import F64, FROM_MAD, I64, Bool

# largest cost of a link, and cost of none: four normal errors have a larger square sum once in 2000
# times
GATE = 20.0
# farthest displacement of a trajectory of unknown velocity, in distances between neighbours
NEIGHBOUR_REACH = 3.0
# largest difference of related neighbours' displacements, in the same unit
ALIKE = 0.4
NEIGHBOURS = 8  # whose displacements a trajectory is compared with
ENOUGH = NEIGHBOURS  # links, or predictions, for a measurement of errors or motion
# candidates of one trajectory: several times what is within the radius where bubbles are evenly
# spread, and a bound where they are not
_MOST = 100
# least and largest errors of predictions: in the same unit, and of the logarithm of radii
_POSITION_ERROR, _SIZE_ERROR = (0.05, 0.2), (0.03, 0.15)


@dataclass(frozen=True)
class _Points:
    """Detections: positions (n, 3), log radii, times and numbers of frames (n,)."""

    position: F64
    size: F64
    time: F64
    frame: I64


@dataclass(frozen=True)
class _Trajectories(_Points):
    """Trajectories that may continue; velocities (n, 3) of new ones are NaN."""

    number: I64
    velocity: F64

    @property
    def young(self) -> Bool:
        return np.isnan(self.velocity[:, 0])

    def __getitem__(self, chosen: Bool | I64) -> _Trajectories:
        names = _Trajectories.__dataclass_fields__
        return _Trajectories(*(getattr(self, name)[chosen] for name in names))


@dataclass(frozen=True)
class _Scale:
    """Distance between neighbours, and errors of predictions and logarithms of radii."""

    spacing: float
    position: F64
    size: float


def link(
    center_mm: Sequence[F64], radius_mm: Sequence[F64], times_s: Sequence[float], gap: int = 1
) -> list[I64]:
    """Link the detections of some frames to trajectories.

    Returns numbers (n,) of each frame's trajectories, counted from 0 in the order of their
    beginnings. A detection that joins no other is a trajectory. Times that do not increase are a
    ValueError.

    Parameters
    ----------
    center_mm, radius_mm : (n, 3) and (n,) of each frame.
    times_s : of the frames.
    gap : number of frames in a row that a trajectory may miss.
    """
    if (np.diff(times_s) <= 0.0).any():
        raise ValueError(f"times_s: expected increasing times, got {list(times_s)}")
    spacing = _spacing(center_mm)
    scale = _Scale(spacing, np.full(3, _POSITION_ERROR[1] * spacing), _SIZE_ERROR[1])
    none, nowhere = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    live = _Trajectories(nowhere, np.zeros(0), np.zeros(0), none, none, nowhere)
    born, out = 0, []
    detections = zip(center_mm, radius_mm, times_s, strict=True)
    for frame, (position, radius, time) in enumerate(detections):
        count = len(position)
        points = _Points(position, np.log(radius), np.full(count, time), np.full(count, frame))
        live = live[frame - live.frame <= gap + 1]
        pairs = _candidates(live, points, time, frame, scale)
        i, j = assign(*pairs, (len(live.position), count))
        scale = _estimate_scale(scale, live[i], points, j)
        number = np.full(count, -1)
        number[j] = live.number[i]
        new = np.flatnonzero(number < 0)
        number[new] = born + np.arange(len(new))
        born += len(new)
        live = _continue(live, points, number, i, j)
        out.append(number)
    return out


def assign(row: I64, column: I64, cost: F64, shape: tuple[int, int]) -> tuple[I64, I64]:
    """Choose pairs of rows and columns, one to one, of the least total cost.

    A row without a column costs `GATE`.

    Parameters
    ----------
    row, column, cost : (n,) possible pairs, each once, with costs from 0 on.
    shape : numbers of rows and columns.
    """
    rows, columns = shape
    alone = np.arange(rows)  # every row has a column of its own, which means none
    edges = (np.concatenate([row, alone]), np.concatenate([column, columns + alone]))
    weights = 1.0 + np.concatenate([cost, np.full(rows, GATE)])  # zero would be no edge
    if not rows:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    costs = coo_array((weights, edges), shape=(rows, columns + rows))
    i, j = min_weight_full_bipartite_matching(costs.tocsr())
    linked = j < columns
    return i[linked].astype(np.int64), j[linked].astype(np.int64)


def _spacing(center_mm: Sequence[F64]) -> float:
    """Compute the median distance of neighbours; without any, more than the extent."""
    several = [positions for positions in center_mm if len(positions) > 1]
    near = [cKDTree(positions).query(positions, 2)[0][:, 1] for positions in several]
    spacing = float(np.median(np.concatenate(near))) if near else 0.0
    every = np.concatenate([np.zeros((0, 3)), *center_mm])
    extent = float(np.linalg.norm(np.ptp(every, axis=0))) if len(every) else 0.0
    return spacing or 10.0 * extent or 1.0


def _continue(live: _Trajectories, points: _Points, number: I64, i: I64, j: I64) -> _Trajectories:
    velocity = np.full(points.position.shape, np.nan)
    velocity[j] = (points.position[j] - live.position[i]) / (points.time[j] - live.time[i])[:, None]
    lost = live[np.setdiff1d(np.arange(len(live.position)), i)]
    now = _Trajectories(points.position, points.size, points.time, points.frame, number, velocity)
    names = _Trajectories.__dataclass_fields__
    pairs = ([getattr(part, name) for part in (lost, now)] for name in names)
    return _Trajectories(*map(np.concatenate, pairs))


def _candidates(
    live: _Trajectories, points: _Points, time: float, frame: int, scale: _Scale
) -> tuple[I64, I64, F64]:
    parts = [part(live, points, time, frame, scale) for part in (_by_velocity, _by_neighbours)]
    row, column, cost = (np.concatenate(values) for values in zip(*parts, strict=True))
    good = cost < GATE
    return row[good], column[good], cost[good]


def _by_velocity(
    live: _Trajectories, points: _Points, time: float, frame: int, scale: _Scale
) -> tuple[I64, I64, F64]:
    """Link trajectories by their last velocities.

    The cost is the square sum of the errors of position and size over their expected values, which
    grow with the number of missed frames.
    """
    old = np.flatnonzero(~live.young)
    steps = (frame - live.frame[old]).astype(np.float64)
    ahead = live.position[old] + live.velocity[old] * (time - live.time[old])[:, None]
    radii = float(np.sqrt(GATE)) * steps
    row, column = _near(ahead / scale.position, points.position / scale.position, radii)
    off = (ahead[row] - points.position[column]) / scale.position
    error = np.sum(off**2, axis=1) / steps[row] ** 2
    return old[row], column, error + _unlike(live, points, old[row], column, scale)


def _by_neighbours(
    live: _Trajectories, points: _Points, time: float, frame: int, scale: _Scale
) -> tuple[I64, I64, F64]:
    """Link trajectories of one detection by their neighbours.

    The cost is the mean over neighbours of the misfit of a displacement to theirs, plus a small
    term for its length.
    """
    young = np.flatnonzero(live.young)
    radii = NEIGHBOUR_REACH * scale.spacing * (frame - live.frame[young]).astype(np.float64)
    row, column = _near(live.position[young], points.position, radii)
    size = _unlike(live, points, young[row], column, scale)
    row, column, size = row[size < GATE], column[size < GATE], size[size < GATE]
    shift = points.position[column] - live.position[young[row]]
    duration = time - live.time[young[row]]
    velocity = shift / duration[:, None]
    if len(live.position) - len(young) >= NEIGHBOURS:
        # the nearest trajectories of known velocity
        old = np.flatnonzero(~live.young)
        _, near = cKDTree(live.position[old]).query(live.position[young[row]], NEIGHBOURS)
        apart = np.linalg.norm(live.velocity[old[near]] - velocity[:, None], axis=2)
        apart = apart * duration[:, None]
    else:
        apart = _position_errors(live, points, young[row], velocity, time, scale)
    length = np.linalg.norm(shift, axis=1)
    # where there are few neighbours, the others are taken to rest
    resting = np.repeat(length[:, None], NEIGHBOURS - apart.shape[1], axis=1)
    apart = np.concatenate([apart, resting], axis=1) / (ALIKE * scale.spacing)
    alone = np.minimum(apart**2, 1.0).mean(axis=1)
    return young[row], column, GATE * alone + (length / radii[row]) ** 2 + size


def _position_errors(
    live: _Trajectories, points: _Points, which: I64, velocity: F64, time: float, scale: _Scale
) -> F64:
    """Compute distances (n, k) of moved neighbours to the next detection.

    Neighbours move by velocities (n, 3). The neighbours are those nearest to trajectories (n,), the
    detections of their size.
    """
    count = min(NEIGHBOURS, len(live.position) - 1)
    if count <= 0 or not len(which):
        return np.zeros((len(which), 0))
    from sabench.utils.compiled import numba  # takes half a second, and only solvers link

    cores = numba.get_num_threads()
    near = cKDTree(live.position).query(live.position, count + 1, workers=cores)[1][which, 1:]
    ahead = live.position[near] + velocity[:, None] * (time - live.time[near])[..., None]
    # three standard errors are as bad as no position
    size = ALIKE * scale.spacing / (3.0 * scale.size)
    tree = cKDTree(np.column_stack([points.position, size * points.size]))
    moved = np.concatenate([ahead, size * live.size[near][..., None]], axis=2)
    distance = tree.query(moved, distance_upper_bound=ALIKE * scale.spacing, workers=cores)[0]
    return np.asarray(distance)


def _near(starts: F64, targets: F64, radii: F64) -> tuple[I64, I64]:
    """Find pairs of rows within the first ones' radii, at most the `_MOST` nearest."""
    if not len(starts) or not len(targets):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    count = min(_MOST, len(targets))
    distance, column = cKDTree(targets).query(
        starts, np.arange(1, count + 1), distance_upper_bound=1.001 * float(radii.max())
    )
    row, slot = np.nonzero(distance <= radii[:, None])
    return row, column[row, slot]


def _unlike(live: _Trajectories, points: _Points, row: I64, column: I64, scale: _Scale) -> F64:
    return np.asarray(((live.size[row] - points.size[column]) / scale.size) ** 2)


def _estimate_scale(scale: _Scale, linked: _Trajectories, points: _Points, j: I64) -> _Scale:
    """Estimate errors of predictions: the median magnitude, as of normal errors."""
    old = ~linked.young
    if old.sum() < ENOUGH:
        return scale
    tracks, j = linked[old], j[old]
    ahead = tracks.position + tracks.velocity * (points.time[j] - tracks.time)[:, None]
    off = (ahead - points.position[j]) / (points.frame[j] - tracks.frame)[:, None]
    low, high = (bound * scale.spacing for bound in _POSITION_ERROR)
    position = np.clip(FROM_MAD * np.median(np.abs(off), axis=0), low, high)
    size = np.clip(FROM_MAD * np.median(np.abs(tracks.size - points.size[j])), *_SIZE_ERROR)
    return replace(scale, position=position, size=float(size))
