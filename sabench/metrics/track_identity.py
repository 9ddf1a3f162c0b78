"""Identities of trajectories: HOTA, switches, fragments, completeness.

HOTA (higher order tracking accuracy) is that of J. Luiten et al., Int. J. Computer Vision 129
(2021) 548. One difference: it pairs detections anew for every distance so as to help identities;
here the closest pairs come first, whatever their identities. Switches and fragments are those of
K. Bernardin and R. Stiefelhagen, EURASIP J. Image and Video Processing (2008) 246309, relative to
the true links.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64, I64

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
        for seen in _by_object(frames).values():
            if len(seen) < 2:
                continue
            there = [number for number in seen if number is not None]
            links += len(seen) - 1
            switches += sum(one != other for one, other in itertools.pairwise(there))
            runs = [found for found, _ in itertools.groupby(seen, lambda one: one is not None)]
            fragments += max(sum(runs) - 1, 0)
            complete.append(len(there) == len(seen) and len(set(there)) == 1)
    return {
        "hota": float(np.mean(quality)) if quality else math.nan,
        "complete": float(np.mean(complete)) if complete else math.nan,
        "switch_percent": 100.0 * switches / links if links else math.nan,
        "fragment_percent": 100.0 * fragments / links if links else math.nan,
    }


def _by_object(frames: Sequence[Sightings]) -> dict[int, list[int | None]]:
    """List for each true object what follows it in its frames: a trajectory, or None."""
    every: dict[int, list[int | None]] = {}
    for frame in frames:
        i, j = frame.pairs
        partner = dict(zip(j.tolist(), frame.trajectory[i].tolist(), strict=True))
        for row, number in enumerate(frame.identity.tolist()):
            every.setdefault(number, []).append(partner.get(row))
    return every


def _hota(frames: Sequence[Sightings]) -> float:
    """Average over the levels of similarity; NaN without true or estimated objects."""
    every = [
        np.concatenate([getattr(frame, name) for frame in frames])
        for name in ("trajectory", "identity")
    ]
    if not len(every[0]) and not len(every[1]):
        return math.nan
    estimates, of_estimate = np.unique(every[0], return_counts=True)
    truths, of_truth = np.unique(every[1], return_counts=True)
    both = np.concatenate(
        [
            np.stack([frame.trajectory[frame.pairs[0]], frame.identity[frame.pairs[1]]], axis=1)
            for frame in frames
        ]
    )
    near = 1.0 - np.concatenate([frame.apart for frame in frames])
    levels = []
    for level in _LEVELS:
        together, times = np.unique(both[near >= level], axis=0, return_counts=True)
        right = int(times.sum())
        whole = of_estimate[np.searchsorted(estimates, together[:, 0])]
        whole = whole + of_truth[np.searchsorted(truths, together[:, 1])] - times
        association = float(np.sum(times * times / whole)) / max(right, 1)
        detection = right / (len(every[0]) + len(every[1]) - right)
        levels.append(math.sqrt(detection * association))
    return float(np.mean(levels))
