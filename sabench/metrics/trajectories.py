"""Found tracks against true ones: which links are right, how far off velocities are, and how much of a true track one found track covers.

Links are counted as the vectors of the first challenge on Lagrangian Particle Tracking are
(Leclaire et al. 2021), but that its recall takes what was not detected for missed, too. The covered
share of a track is the target effectiveness of Bise et al., "Reliable cell tracking by global data
association", ISBI 2011.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sabench.api.truth import Bubbles
from sabench.metrics.bubble_detection import AnyBubbles, match
from sabench.utils.arrays import F64, I64

_KEYS = ("link_recall", "link_precision", "effectiveness", "velocity_mm_s", "velocity_percent")


def track_scores(
    found: Sequence[AnyBubbles],
    track: Sequence[I64],
    true: Sequence[Bubbles],
    times_s: Sequence[float],
    sequences: Sequence[range],
) -> dict[str, float]:
    """All figures of tracks; NaN where there is nothing to count, as where no frame follows another.

    Parameters
    ----------
    found, true : the bubbles of each frame.
    track : numbers (n,) of the tracks of each frame's found bubbles.
    times_s : when each frame was taken.
    sequences : the frames that follow each other; nothing is asked of tracks from one to the next.
    """
    matched = [
        match(guess.center_mm, known.center_mm, known.radius_mm)
        for guess, known in zip(found, true, strict=True)
    ]
    places = [[one.center_mm for one in frames] for frames in (found, true)]
    return link_scores(
        places[0], track, places[1], [one.id for one in true], matched, times_s, sequences
    )


def link_scores(
    found_mm: Sequence[F64],
    track: Sequence[I64],
    true_mm: Sequence[F64],
    identity: Sequence[I64],
    matched: Sequence[tuple[I64, I64]],
    times_s: Sequence[float],
    sequences: Sequence[range],
) -> dict[str, float]:
    """The same of any things that move, whose pairs of found and true ones are known.

    Parameters
    ----------
    found_mm, true_mm : (n, 3) and (m, 3), places in each frame.
    track, identity : numbers (n,) of the found ones' tracks, and (m,) that name the true ones.
    matched : rows of the found and of the true ones that belong together, for each frame.
    times_s, sequences : as in `track_scores`.
    """
    there, right, links = 0, 0, 0
    off, speed, cover = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for frames in sequences:
        for one, other in itertools.pairwise(frames):
            i, j, k, m = _same(identity, matched, one, other)
            good = track[one][i] == track[other][k]
            there, right = there + len(good), right + int(good.sum())
            links += len(np.intersect1d(track[one], track[other]))
            duration = times_s[other] - times_s[one]
            velocity = (true_mm[other][m] - true_mm[one][j])[good] / duration
            off.append(
                np.linalg.norm(
                    (found_mm[other][k] - found_mm[one][i])[good] / duration - velocity, axis=1
                )
            )
            speed.append(np.linalg.norm(velocity, axis=1))
        cover.append(
            _covered(
                [track[f][matched[f][0]] for f in frames],
                [identity[f][matched[f][1]] for f in frames],
                [identity[f] for f in frames],
            )
        )
    figures = (
        _part(right, there),
        _part(right, links),
        _mean(np.concatenate(cover)),
        *_errors(np.concatenate(off), np.concatenate(speed)),
    )
    return dict(zip(_KEYS, figures, strict=True))


def _same(
    identity: Sequence[I64], matched: Sequence[tuple[I64, I64]], one: int, other: int
) -> tuple[I64, I64, I64, I64]:
    """Rows of those that were found in both frames: found and true ones in the first, found and true ones in the second."""
    (i, j), (k, m) = matched[one], matched[other]
    _, first, second = np.intersect1d(identity[one][j], identity[other][m], return_indices=True)
    return i[first], j[first], k[second], m[second]


def _covered(track: Sequence[I64], identity: Sequence[I64], every: Sequence[I64]) -> F64:
    """For each bubble that is there in two frames or more: the part of them in which the track that has it most often has it.

    Parameters
    ----------
    track, identity : (n,) of each frame's pairs of found and true bubbles.
    every : ids of all true bubbles of each frame.
    """
    bubbles, frames = np.unique(np.concatenate(every), return_counts=True)
    both, times = np.unique(
        np.column_stack([np.concatenate(identity), np.concatenate(track)]),
        axis=0,
        return_counts=True,
    )
    most = np.zeros(len(bubbles), dtype=np.int64)
    np.maximum.at(most, np.searchsorted(bubbles, both[:, 0]), times)
    return (most / frames)[frames > 1]


def _errors(off: F64, speed: F64) -> tuple[float, float]:
    """Median error, and median error over the true speed in per cent of what moves."""
    moving = speed > 0.0
    return _median(off), 100.0 * _median(off[moving] / speed[moving])


def _median(values: F64) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _mean(values: F64) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _part(count: int, whole: int) -> float:
    return count / whole if whole else float("nan")
