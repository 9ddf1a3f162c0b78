"""Estimated trajectories against true ones: links, velocities, and coverage.

Links are counted as the vectors of the first challenge on Lagrangian Particle Tracking are
(Leclaire et al. 2021). One difference: its recall counts undetected particles as missed, too. The
coverage of a true trajectory by one estimated trajectory is the target effectiveness of Bise et
al., "Reliable cell tracking by global data association", ISBI 2011.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sabench.api.truth import Bubbles
from sabench.metrics.averages import ratio
from sabench.metrics.bubble_detection import AnyBubbles, match
from sabench.metrics.motion_errors import median_errors
from sabench.utils.arrays import F64, I64

_KEYS = ("link_recall", "link_precision", "effectiveness", "velocity_mm_s", "velocity_percent")


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
        match(one.center_mm, true.center_mm, true.radius_mm)
        for one, true in zip(estimate, truth, strict=True)
    ]
    return link_scores(
        [one.center_mm for one in estimate],
        trajectory,
        [one.center_mm for one in truth],
        [one.id for one in truth],
        matched,
        times_s,
        sequences,
    )


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
    """
    there, right, links = 0, 0, 0
    off, speed, cover = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for frames in sequences:
        for one, other in itertools.pairwise(frames):
            i, j, k, m = _in_both(identity, matched, one, other)
            good = trajectory[one][i] == trajectory[other][k]
            there, right = there + len(good), right + int(good.sum())
            links += len(np.intersect1d(trajectory[one], trajectory[other]))
            duration = times_s[other] - times_s[one]
            velocity = (truth_mm[other][m] - truth_mm[one][j])[good] / duration
            off.append(
                np.linalg.norm(
                    (estimate_mm[other][k] - estimate_mm[one][i])[good] / duration - velocity,
                    axis=1,
                )
            )
            speed.append(np.linalg.norm(velocity, axis=1))
        cover.append(
            _coverage(
                [trajectory[f][matched[f][0]] for f in frames],
                [identity[f][matched[f][1]] for f in frames],
                [identity[f] for f in frames],
            )
        )
    figures = (
        ratio(right, there),
        ratio(right, links),
        _mean(np.concatenate(cover)),
        *median_errors(np.concatenate(off), np.concatenate(speed)),
    )
    return dict(zip(_KEYS, figures, strict=True))


def vector_scores(
    estimate_mm: Sequence[F64],
    trajectory: Sequence[I64],
    truth_mm: Sequence[F64],
    identity: Sequence[I64],
    matched: Sequence[tuple[I64, I64]],
    sequences: Sequence[range],
) -> dict[str, float]:
    """Score displacements as the first LPT challenge does (Leclaire et al. 2021).

    Arguments as for `link_scores`. Keys: vector_recall, the share of the true displacements between
    consecutive frames that a trajectory has, so that particles that were not found count as missed;
    displacement_mm, the root mean square error of these displacements. NaN without any.
    """
    right, there, squares = 0, 0, [np.zeros(0)]
    for one, other in (pair for frames in sequences for pair in itertools.pairwise(frames)):
        i, j, k, m = _in_both(identity, matched, one, other)
        good = trajectory[one][i] == trajectory[other][k]
        found = estimate_mm[other][k] - estimate_mm[one][i]
        off = (found - truth_mm[other][m] + truth_mm[one][j])[good]
        right, there = right + len(off), there + len(np.intersect1d(identity[one], identity[other]))
        squares.append(np.square(off).sum(axis=1))
    return {
        "vector_recall": ratio(right, there),
        "displacement_mm": float(np.sqrt(_mean(np.concatenate(squares)))),
    }


def _in_both(
    identity: Sequence[I64], matched: Sequence[tuple[I64, I64]], one: int, other: int
) -> tuple[I64, I64, I64, I64]:
    """Find the pairs of two frames that share a true object.

    Returns the rows of the estimated and true ones in the first, then in the second frame.
    """
    (i, j), (k, m) = matched[one], matched[other]
    _, first, second = np.intersect1d(identity[one][j], identity[other][m], return_indices=True)
    return i[first], j[first], k[second], m[second]


def _coverage(trajectory: Sequence[I64], identity: Sequence[I64], every: Sequence[I64]) -> F64:
    """Compute the fraction of each true trajectory that one estimate covers.

    Only objects that exist in two frames or more count.

    Parameters
    ----------
    trajectory, identity : (n,) numbers of each frame's pairs of estimated and true objects.
    every : numbers of all true objects of each frame.
    """
    objects, frames = np.unique(np.concatenate(every), return_counts=True)
    both, times = np.unique(
        np.column_stack([np.concatenate(identity), np.concatenate(trajectory)]),
        axis=0,
        return_counts=True,
    )
    most = np.zeros(len(objects), dtype=np.int64)
    np.maximum.at(most, np.searchsorted(objects, both[:, 0]), times)
    return (most / frames)[frames > 1]


def _mean(values: F64) -> float:
    return float(values.mean()) if len(values) else float("nan")
