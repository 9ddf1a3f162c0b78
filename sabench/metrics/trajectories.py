"""Errors, links, identity and smoothness of trajectories.

HOTA (higher order tracking accuracy) is that of J. Luiten et al., Int. J. Computer Vision 129
(2021) 548. One difference: it pairs detections anew for every distance so as to help identities;
here the closest pairs come first, whatever their identities. Switches and fragments are those of
K. Bernardin and R. Stiefelhagen, EURASIP J. Image and Video Processing (2008) 246309, relative to
the true links.

Links are counted as the vectors of the first challenge on Lagrangian Particle Tracking are
(Leclaire et al. 2021). One difference: its recall counts undetected particles as missed, too. The
coverage of a true trajectory by one estimated trajectory is the target effectiveness of Bise et
al., "Reliable cell tracking by global data association", ISBI 2011.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sabench.api.truth import Bubbles
from sabench.metrics.averages import ratio
from sabench.metrics.bubble_detection import AnyBubbles, match_bubbles
from sabench.utils.arrays import F64, I64


def accelerations(frames: Sequence[tuple[I64, F64]], duration: float) -> tuple[I64, F64]:
    """Compute second differences of three frames' positions over duration squared.

    Parameters
    ----------
    frames : numbers (n,) and positions (n, 3) in each of the three, n differs.
    duration : between two frames; equal for both pairs.

    Returns rows (k,) of the middle frame with numbers in all three, and accelerations (k, 3).
    """
    (first, before), (middle, now), (last, after) = frames
    _, i, j = np.intersect1d(first, middle, return_indices=True)
    _, k, m = np.intersect1d(middle[j], last, return_indices=True)
    rows = j[k]
    return rows, (before[i[k]] - 2.0 * now[rows] + after[m]) / duration**2


def claimed_errors(pairs: Sequence[tuple[F64, F64]]) -> tuple[F64, F64]:
    """Compute the lengths of the errors of all vectors (n, 3), and true lengths."""
    none = np.zeros((0, 3))
    estimate = np.concatenate([none, *(vectors for vectors, _ in pairs)])
    true = np.concatenate([none, *(other for _, other in pairs)])
    return np.linalg.norm(estimate - true, axis=1), np.linalg.norm(true, axis=1)


def median_errors(off: F64, size: F64) -> tuple[float, float]:
    """Compute the median error, and that over true sizes above 0 in percent, or NaN."""
    some = size > 0.0
    return _median(off), 100.0 * _median(off[some] / size[some])


def _median(values: F64) -> float:
    return float(np.median(values)) if len(values) else float("nan")


_LEVELS = np.arange(1, 20) / 20.0  # of similarity


@dataclass(frozen=True)
class Sightings:
    """Estimated and true objects of one frame.

    Attributes
    ----------
    trajectory, identity : numbers (n,) of the estimated trajectories, and (m,) of the true ones.
    pairs : rows of the estimated and of the true objects that form pairs.
    apart : distance of each pair, relative to the largest that makes one.
    """

    trajectory: I64
    identity: I64
    pairs: tuple[I64, I64]
    apart: F64


def identity_scores(sequences: Sequence[Sequence[Sightings]]) -> dict[str, float]:
    """Score the identities in the frames of each sequence.

    NaN where there is nothing to score. Keys: hota; complete, the share of true trajectories of two
    frames or more that one estimated one has in all frames; switch_percent and fragment_percent,
    relative to the true links.
    """
    quality, complete = [], []
    links = switches = fragments = 0
    for frames in sequences:
        quality.append(_hota(frames))
        followers: dict[int, list[int | None]] = {}  # trajectories, or None, of each true object
        for frame in frames:
            i, j = frame.pairs
            partner = dict(zip(j.tolist(), frame.trajectory[i].tolist(), strict=True))
            for row, number in enumerate(frame.identity.tolist()):
                followers.setdefault(number, []).append(partner.get(row))
        for numbers in followers.values():
            if len(numbers) < 2:
                continue
            matched = [number for number in numbers if number is not None]
            links += len(numbers) - 1
            switches += sum(before != after for before, after in itertools.pairwise(matched))
            runs = [run for run, _ in itertools.groupby(numbers, lambda number: number is not None)]
            fragments += max(sum(runs) - 1, 0)
            complete.append(len(matched) == len(numbers) and len(set(matched)) == 1)
    return {
        "hota": float(np.mean(quality)) if quality else math.nan,
        "complete": float(np.mean(complete)) if complete else math.nan,
        "switch_percent": 100.0 * switches / links if links else math.nan,
        "fragment_percent": 100.0 * fragments / links if links else math.nan,
    }


def _hota(frames: Sequence[Sightings]) -> float:
    """Average over the levels of similarity; NaN without true or estimated objects."""
    trajectory = np.concatenate([frame.trajectory for frame in frames])
    identity = np.concatenate([frame.identity for frame in frames])
    if not len(trajectory) and not len(identity):
        return math.nan
    estimates, of_estimate = np.unique(trajectory, return_counts=True)
    truths, of_truth = np.unique(identity, return_counts=True)
    pairs = [(frame.trajectory[frame.pairs[0]], frame.identity[frame.pairs[1]]) for frame in frames]
    both = np.concatenate(pairs, axis=1).T
    near = 1.0 - np.concatenate([frame.apart for frame in frames])
    levels = []
    for level in _LEVELS:
        together, times = np.unique(both[near >= level], axis=0, return_counts=True)
        right = int(times.sum())
        whole = of_estimate[np.searchsorted(estimates, together[:, 0])]
        whole = whole + of_truth[np.searchsorted(truths, together[:, 1])] - times
        association = float(np.sum(times * times / whole)) / max(right, 1)
        detection = right / (len(trajectory) + len(identity) - right)
        levels.append(math.sqrt(detection * association))
    return float(np.mean(levels))


_LINKS = ("link_recall", "link_precision", "effectiveness", "velocity_mm_s", "velocity_percent")
_KEYS = (*_LINKS, "vector_recall", "displacement_mm")


def trajectory_scores(
    estimate: Sequence[AnyBubbles],
    trajectory: Sequence[I64],
    truth: Sequence[Bubbles],
    times_s: Sequence[float],
    sequences: Sequence[range],
) -> dict[str, float]:
    """Score trajectories of bubbles; NaN where there is nothing to count.

    Parameters
    ----------
    estimate, truth : the bubbles of each frame.
    trajectory : numbers (n,) of the trajectories of each frame's estimated bubbles.
    times_s : time of each frame.
    sequences : frames that follow each other; trajectories from one to the next do not count.
    """
    matched = [
        match_bubbles(frame.center_mm, true.center_mm, true.radius_mm)
        for frame, true in zip(estimate, truth, strict=True)
    ]
    centers, true_centers = ([frame.center_mm for frame in part] for part in (estimate, truth))
    identity = [frame.id for frame in truth]
    places = centers, trajectory, true_centers, identity, matched
    scores = link_scores(*places, times_s, sequences)
    return {key: scores[key] for key in _LINKS}


def link_scores(
    estimate_mm: Sequence[F64],
    trajectory: Sequence[I64],
    truth_mm: Sequence[F64],
    identity: Sequence[I64],
    matched: Sequence[tuple[I64, I64]],
    times_s: Sequence[float],
    sequences: Sequence[range],
) -> dict[str, float]:
    """Score trajectories of objects that are already paired with true ones.

    Parameters
    ----------
    estimate_mm, truth_mm : positions (n, 3) and (m, 3) in each frame.
    trajectory, identity : numbers (n,) of the estimated trajectories, and (m,) of the true ones.
    matched : for each frame, rows of the estimated and of the true ones that form pairs.
    times_s, sequences : as in `trajectory_scores`.

    The last two keys are those of the first LPT challenge (Leclaire et al. 2021): the share of the
    true displacements between consecutive frames that a trajectory has, so that particles that were
    not found count as missed; the root mean square error of these displacements. NaN without any.
    """
    total, right, links, every = 0, 0, 0, 0
    off, speed, cover, squares = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for frames in sequences:
        for old, new in itertools.pairwise(frames):
            (i, j), (k, m) = matched[old], matched[new]  # rows of those that are in both frames
            _, a, b = np.intersect1d(identity[old][j], identity[new][m], return_indices=True)
            i, j, k, m = i[a], j[a], k[b], m[b]
            good = trajectory[old][i] == trajectory[new][k]
            total, right = total + len(good), right + int(good.sum())
            links += len(np.intersect1d(trajectory[old], trajectory[new]))
            every += len(np.intersect1d(identity[old], identity[new]))
            shift, duration = estimate_mm[new][k] - estimate_mm[old][i], times_s[new] - times_s[old]
            error = (shift - truth_mm[new][m] + truth_mm[old][j])[good]
            squares.append(np.square(error).sum(axis=1))
            velocity = (truth_mm[new][m] - truth_mm[old][j])[good] / duration
            estimated = shift[good] / duration
            off.append(np.linalg.norm(estimated - velocity, axis=1))
            speed.append(np.linalg.norm(velocity, axis=1))
        pairs = [(identity[f][matched[f][1]], trajectory[f][matched[f][0]]) for f in frames]
        cover.append(_coverage(pairs, [identity[f] for f in frames]))
    figures = (
        ratio(right, total),
        ratio(right, links),
        _mean(np.concatenate(cover)),
        *median_errors(np.concatenate(off), np.concatenate(speed)),
        ratio(right, every),
        float(np.sqrt(_mean(np.concatenate(squares)))),
    )
    return dict(zip(_KEYS, figures, strict=True))


def _coverage(pairs: Sequence[tuple[I64, I64]], every: Sequence[I64]) -> F64:
    """Compute the fraction of each true trajectory that one estimate covers.

    Only objects that exist in two frames or more count.

    Parameters
    ----------
    pairs : numbers (n,) of the true and estimated objects that form pairs, for each frame.
    every : numbers of all true objects of each frame.
    """
    objects, frames = np.unique(np.concatenate(every), return_counts=True)
    both, times = np.unique(np.concatenate(pairs, axis=1).T, axis=0, return_counts=True)
    most = np.zeros(len(objects), dtype=np.int64)
    np.maximum.at(most, np.searchsorted(objects, both[:, 0]), times)
    return (most / frames)[frames > 1]


def _mean(values: F64) -> float:
    return float(values.mean()) if len(values) else float("nan")


def differences(numbers: Sequence[I64], positions: Sequence[F64], order: int) -> F64:
    """Compute differences (k, 3) of positions of trajectories over frames in a row.

    Parameters
    ----------
    numbers, positions : trajectories (n,) and positions (n, 3) in each frame.
    order : 2 or 3, of differences over 3 or 4 frames.
    """
    parts = [np.zeros((0, 3))]
    for first in range(len(numbers) - order):
        window = range(first, first + order + 1)
        common = functools.reduce(np.intersect1d, numbers[first : first + order + 1])
        places = []
        for frame in window:
            sorter = np.argsort(numbers[frame])
            rows = sorter[np.searchsorted(numbers[frame], common, sorter=sorter)]
            places.append(positions[frame][rows])
        parts.append(np.diff(places, order, axis=0)[0])
    return np.concatenate(parts)


def jitter_mm(numbers: Sequence[I64], positions: Sequence[F64]) -> float:
    """Estimate the standard deviation of positions along each axis from their jitter.

    Third differences of four frames in a row vanish for smooth trajectories, and errors of
    positions give them 20 times their variance; with three frames it is second differences, and 6
    times. The median over all distances resists wrong links. NaN without three frames in a row.
    """
    order = 3 if len(numbers) > 3 else 2
    jumps = differences(numbers, positions, order)
    if not len(jumps):
        return float("nan")
    # median of the length of normal vectors in space, over the deviation along an axis
    scale = 1.5382 * math.sqrt(math.comb(2 * order, order))
    return float(np.median(np.linalg.norm(jumps, axis=1)) / scale)


def share_followed(numbers: Sequence[I64], frames: int) -> float:
    """Compute the share of found particles in long enough trajectories, or NaN."""
    every = np.concatenate([np.zeros(0, dtype=np.int64), *numbers])
    if not len(every):
        return float("nan")
    counts = np.unique(every, return_counts=True)[1]
    return float(counts[counts >= frames].sum() / len(every))
