"""Ranks of entries by their scores over the same data sets."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from sabench.utils.arrays import F64, Bool
from sabench.utils.confidence import quantile


def ranks(scores: F64, larger: bool) -> list[int]:
    """Rank entries by their scores (entry, seed) of the same data sets.

    A rank is 1 plus the number of entries that are better beyond chance: the 95 % confidence
    interval of the mean difference over the seeds, paired by seed, excludes zero. Entries that
    seeds cannot tell apart share a rank, but none is before an entry with a better mean: a large
    scatter improves no rank. A single seed gives no interval; its scores rank as they are.
    """
    gain = np.asarray(scores if larger else -scores, dtype=np.float64)
    found, worst = [0] * len(gain), 1
    for row in np.argsort(-gain.mean(axis=1), kind="stable"):
        worst = max(worst, 1 + int(_beat(gain, gain[row]).sum()))
        found[row] = worst
    return found


def _beat(gain: F64, one: F64) -> Bool:
    """Mark the entries (entry, seed) that are better than one (seed,) beyond chance."""
    apart = gain - one
    mean, count = apart.mean(axis=1), apart.shape[1]
    if count == 1:
        return np.asarray(mean > 0.0)
    error = apart.std(axis=1, ddof=1) / np.sqrt(count)
    return np.asarray(mean > quantile(count) * error)


def ranks_of_distinct(scores: F64, larger: bool, names: Sequence[Hashable]) -> list[int]:
    """Rank entries, of which those with one name are one result, sent several times.

    It takes one rank, so that sending it again pushes nobody down.
    """
    first = {name: row for row, name in reversed(list(enumerate(names)))}
    rows = sorted(first.values())
    found = dict(zip(rows, ranks(scores[rows], larger), strict=True))
    return [found[first[name]] for name in names]


def mean_rank(found: Sequence[int | None], last: Sequence[int]) -> float:
    """Average ranks over cases; a case without one counts as the rank after the last.

    Leaving out a hard case therefore improves no mean.

    Parameters
    ----------
    found : rank in each case, or None.
    last : the number of ranked results of each case.
    """
    pairs = zip(found, last, strict=True)
    return sum(most + 1 if one is None else one for one, most in pairs) / len(found)
