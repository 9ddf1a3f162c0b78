"""Particles in a volume, and how many of them are true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from sabench.metrics.connected_components import component_sums
from sabench.metrics.local_maxima import fitted_maxima
from sabench.utils.arrays import F32, F64, I64, Bool

THESIS_RADIUS = 1.5  # voxels, Euclidean
CHALLENGE_RADIUS = 1.0  # voxels, largest component, exclusive
_LOWEST = 0.10


def detect(volume: F32) -> F64:
    """Intensity-weighted centroids (n, 3) of the components of a volume (z, y, x), as fractional voxel indices (x, y, z).

    Non-zero intensities below their own 10 % quantile are removed, the rest is joined into
    26-connected components: thesis section 3.3.2, after Elsinga et al. (2006). The thesis takes the
    centroid of the binary component; weighting it with the intensity is more exact.
    """
    floor = _floor(volume)
    if floor is None:
        return np.empty((0, 3))
    sums = component_sums(volume, floor)
    return np.asarray(sums[:, 1:] / sums[:, :1])


def detect_peaks(volume: F32) -> F64:
    """Local maxima (n, 3) of a volume (z, y, x), as fractional voxel indices (x, y, z): particles that touch are still told apart.

    A maximum is a voxel that reaches the 10 % quantile of the non-zero intensities and exceeds its
    26 neighbours, or a plateau of equal voxels that does. A Gaussian through the voxel and its two
    neighbours gives its place along each axis.
    """
    floor = _floor(volume)
    return np.empty((0, 3)) if floor is None else fitted_maxima(volume, floor)


def _floor(volume: F32) -> float | None:
    """The 10 % quantile of the intensities above zero; None if there are none."""
    lit = volume[volume > 0.0]
    return float(np.quantile(lit, _LOWEST, overwrite_input=True)) if lit.size else None


@dataclass(frozen=True)
class Counts:
    """Detections against truths: how many there are, how many of each are matched, and the rms distance of the matched in voxels (None: no match)."""

    truths: int
    detections: int
    matched: int
    rms: float | None

    @property
    def recall(self) -> float:
        """Matched truths / truths; 0 without truths."""
        return self.matched / self.truths if self.truths else 0.0

    @property
    def precision(self) -> float:
        """Matched detections / detections; 0 without detections."""
        return self.matched / self.detections if self.detections else 0.0

    @property
    def true_percent(self) -> float:
        """Truths that were found, percent."""
        return 100.0 * self.recall

    @property
    def ghost_percent(self) -> float | None:
        """Detections that match no truth, as a percentage of those that do (thesis figure 3-6b); None: only ghosts."""
        ghosts = self.detections - self.matched
        return 100.0 * ghosts / self.matched if self.matched else (None if ghosts else 0.0)


def count_thesis(
    detections: F64, truths: F64, scored_detections: Bool, scored_truths: Bool
) -> Counts:
    """The thesis's rule (section 3.3.2): a detection within 1.5 voxels of a truth is true, one per truth; duplicates and the rest are ghosts.

    Every detection goes to its nearest truth; the nearest detection of a truth is the true one.

    Parameters
    ----------
    detections, truths : (n, 3) and (m, 3) in voxels.
    scored_detections, scored_truths : which of them lie in the scored part. Matches reach over its
        border, counts do not.
    """
    if not len(detections) or not len(truths):
        return Counts(int(scored_truths.sum()), int(scored_detections.sum()), 0, None)
    distance, nearest = cKDTree(truths).query(
        detections, distance_upper_bound=np.nextafter(THESIS_RADIUS, 2.0)
    )
    order = np.argsort(distance, kind="stable")
    order = order[np.isfinite(distance[order])]
    _, first = np.unique(nearest[order], return_index=True)
    chosen = order[first]
    return _counts(
        chosen,
        nearest[chosen].astype(np.int64),
        detections,
        truths,
        scored_detections,
        scored_truths,
    )


def count_challenge(
    detections: F64, truths: F64, scored_detections: Bool, scored_truths: Bool
) -> Counts:
    """The rule of the LPT challenge: a pair closer than 1 voxel in every component, each truth and each detection in one pair only.

    Pairs are taken from the closest on. Arguments as for `count_thesis`; source: Leclaire et al.
    (2021), first challenge on LPT and DA.
    """
    a, b = challenge_pairs(detections, truths)
    return _counts(a, b, detections, truths, scored_detections, scored_truths)


def challenge_pairs(detections: F64, truths: F64) -> tuple[I64, I64]:
    """Rows of detections (n, 3) and of truths (m, 3), in voxels, that the rule of the LPT challenge pairs."""
    if not len(detections) or not len(truths):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    pairs = cKDTree(detections).query_ball_tree(cKDTree(truths), CHALLENGE_RADIUS, p=np.inf)
    left = np.repeat(np.arange(len(pairs)), [len(found) for found in pairs])
    right = np.fromiter(
        (truth for found in pairs for truth in found), dtype=np.int64, count=len(left)
    )
    offset = detections[left] - truths[right]
    near = np.abs(offset).max(axis=1) < CHALLENGE_RADIUS
    order = np.argsort(np.linalg.norm(offset[near], axis=1), kind="stable")
    return _one_to_one(left[near][order], right[near][order], len(detections), len(truths))


def _one_to_one(left: I64, right: I64, lefts: int, rights: int) -> tuple[I64, I64]:
    """Pairs in order, those left out whose partner is taken."""
    free_left, free_right = [True] * lefts, [True] * rights
    kept = []
    for i, (a, b) in enumerate(zip(left.tolist(), right.tolist(), strict=True)):
        if free_left[a] and free_right[b]:
            free_left[a] = free_right[b] = False
            kept.append(i)
    return left[kept], right[kept]


def _counts(
    a: I64, b: I64, detections: F64, truths: F64, scored_detections: Bool, scored_truths: Bool
) -> Counts:
    """Counts over the scored part: an unmatched detection or truth counts where it lies, a pair where its truth lies."""
    inside = scored_truths[b]
    offset = detections[a[inside]] - truths[b[inside]]
    alone = scored_detections.copy()
    alone[a] = False
    matched = int(inside.sum())
    rms = float(np.sqrt(np.mean(np.sum(offset**2, axis=1)))) if matched else None
    return Counts(int(scored_truths.sum()), matched + int(alone.sum()), matched, rms)
