"""Detection of particles in a volume, and counts of true and ghost particles.

Particles are connected components of bright voxels, or local maxima with sub-voxel positions, both
among 26 neighbours.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, maximum_filter
from scipy.spatial import cKDTree

from sabench.plotting.kinds import DUPLICATE, FOUND, GHOST
from sabench.utils.arrays import F32, F64, I64, U8, Bool

_AROUND = np.ones((3, 3, 3), dtype=np.bool_)


def component_sums(volume: F32, floor: float) -> F64:
    """Sum E, E x, E y, E z (n, 4) over the voxels of each component of E >= floor."""
    numbers, count = label(volume >= floor, _AROUND)
    sums = np.zeros((4, count))
    for z, (plane, labels) in enumerate(zip(volume, numbers, strict=True)):
        y, x = np.nonzero(labels)
        component, weight = labels[y, x] - 1, plane[y, x].astype(np.float64)
        for total, place in zip(sums, (1.0, x, y, float(z)), strict=True):
            total += np.bincount(component, weights=weight * place, minlength=count)
    return np.ascontiguousarray(sums.T)


def fitted_maxima(volume: F32, floor: float) -> F64:
    """Locate the maxima of E >= floor as fractional voxel indices (n, 3) of x, y, z.

    They are in the order of their first voxels. A voxel higher than its 26 neighbours is a maximum;
    so is a plateau, connected voxels of one value, that no neighbour exceeds, at the mean of its
    voxels.
    """
    highest = (volume >= floor) & (volume == maximum_filter(volume, 3, mode="nearest"))
    # neighbours among these are equal; an equal one beside them is lower than another voxel
    beside = maximum_filter(np.where(highest, np.float32(-np.inf), volume), 3, mode="nearest")
    leads_up = (beside == volume)[highest]
    del beside
    voxels = np.flatnonzero(highest)
    plateau = label(highest, _AROUND)[0][highest] - 1
    _, first, size = np.unique(plateau, return_index=True, return_counts=True)
    places = np.unravel_index(voxels, volume.shape)[::-1]
    position = np.stack([np.bincount(plateau, axis) / size for axis in places], axis=1)
    top = np.bincount(plateau, leads_up) == 0.0
    single = top & (size == 1)
    position[single] = _fit(volume, voxels[first[single]])
    return np.asarray(position[top][np.argsort(first[top])])


def _fit(volume: F32, voxels: I64) -> F64:
    """Fit Gaussians through voxels and their neighbours: x, y, z (n, 3)."""
    places = np.unravel_index(voxels, volume.shape)
    position = np.stack(places[::-1], axis=1).astype(np.float64).reshape(-1, 3)
    flat, step = volume.reshape(-1), 1
    for axis, size in enumerate(volume.shape[::-1]):
        rows = np.flatnonzero((position[:, axis] > 0) & (position[:, axis] < size - 1))
        at = voxels[rows]
        values = zip(*(flat[at + k].tolist() for k in (-step, 0, step)), strict=True)
        position[rows, axis] += [three_point(*three) for three in values]
        step *= size
    return position


def three_point(before: float, value: float, after: float) -> float:
    """Compute the offset of the vertex of a Gaussian through three values.

    The middle value is the highest; the offset lies between -1/2 and 1/2. Where a neighbour is 0
    and has no logarithm, it is that of the centroid of the three values.

    Source: Willert and Gharib, Exp. Fluids 10 (1991) 181-193.
    """
    if before <= 0.0 or after <= 0.0:
        return (after - before) / (before + value + after)
    a, b, c = math.log(before), math.log(value), math.log(after)
    return 0.5 * (a - c) / (a - 2.0 * b + c)


THESIS_RADIUS = 1.5  # voxels, Euclidean
CHALLENGE_RADIUS = 1.0  # voxels, largest component, exclusive
MATCHING_DISTANCES = tuple((np.arange(1, 11) / 10.0).tolist())  # voxels, of curves of F1
_LOWEST = 0.10


def detect(volume: F32) -> F64:
    """Detect particles in a volume (z, y, x) as connected components.

    Returns their intensity-weighted centroids (n, 3), fractional voxel indices (x, y, z). Non-zero
    intensities below their own 10 % quantile are removed, the rest is joined into 26-connected
    components: thesis section 3.3.2, after Elsinga et al. (2006). The thesis takes the centroid of
    the binary component; weighting it with the intensity is more exact.
    """
    floor = _floor(volume)
    if floor is None:
        return np.empty((0, 3))
    sums = component_sums(volume, floor)
    return np.asarray(sums[:, 1:] / sums[:, :1])


def detect_peaks(volume: F32) -> F64:
    """Detect particles in a volume (z, y, x) as local maxima.

    Returns fractional voxel indices (n, 3) of x, y, z. Particles that touch are separated.

    A maximum is a voxel that reaches the 10 % quantile of the non-zero intensities and exceeds its
    26 neighbours, or a plateau of equal voxels that does. A Gaussian through the voxel and its two
    neighbours gives its position along each axis.
    """
    floor = _floor(volume)
    return np.empty((0, 3)) if floor is None else fitted_maxima(volume, floor)


def _floor(volume: F32) -> float | None:
    """Compute the 10 % quantile of the intensities above zero; None without any."""
    bright = volume[volume > 0.0]
    return float(np.quantile(bright, _LOWEST, overwrite_input=True)) if bright.size else None


@dataclass(frozen=True)
class Counts:
    """Counts of true particles and of detections, and of matched pairs.

    Attributes
    ----------
    truths, detections, matched : numbers of true particles, of detections, and of pairs of both.
    rms : root mean square distance of the pairs, voxels; None without any.
    """

    truths: int
    detections: int
    matched: int
    rms: float | None

    @property
    def recall(self) -> float:
        """Matched / true particles; 0 without true ones."""
        return self.matched / self.truths if self.truths else 0.0

    @property
    def precision(self) -> float:
        """Matched / all detections; 0 without detections."""
        return self.matched / self.detections if self.detections else 0.0

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 0 without pairs."""
        return 2.0 * self.matched / (self.truths + self.detections) if self.matched else 0.0

    @property
    def true_percent(self) -> float:
        """Percentage of the true particles that are detected."""
        return 100.0 * self.recall

    @property
    def ghost_percent(self) -> float | None:
        """Unmatched over matched detections, percent (figure 3-6b); None for only ghosts."""
        ghosts = self.detections - self.matched
        return 100.0 * ghosts / self.matched if self.matched else (None if ghosts else 0.0)


def count_thesis(estimate: F64, truth: F64, scored_estimate: Bool, scored_truth: Bool) -> Counts:
    """Count detections by the rule of the thesis (section 3.3.2).

    Every detection belongs to the nearest true particle within 1.5 voxels. The nearest detection of
    a true particle matches it; duplicates and all others are ghosts.

    Parameters
    ----------
    estimate, truth : (n, 3) and (m, 3) in voxels.
    scored_estimate, scored_truth : which of them lie in the scored part. Pairs may cross its
        border, counts stop there.
    """
    if not len(estimate) or not len(truth):
        return Counts(int(scored_truth.sum()), int(scored_estimate.sum()), 0, None)
    distance, nearest = cKDTree(truth).query(
        estimate, distance_upper_bound=np.nextafter(THESIS_RADIUS, 2.0)
    )
    order = np.argsort(distance, kind="stable")
    order = order[np.isfinite(distance[order])]
    _, first = np.unique(nearest[order], return_index=True)
    chosen = order[first]
    matched = nearest[chosen].astype(np.int64)
    return _counts(chosen, matched, estimate, truth, scored_estimate, scored_truth)


def count_challenge(estimate: F64, truth: F64, scored_estimate: Bool, scored_truth: Bool) -> Counts:
    """Count detections by the rule of the LPT challenge.

    A detection matches a true particle closer than 1 voxel along every axis. Each of them is in one
    pair only; pairs are taken from the closest on. Arguments as for `count_thesis`.

    Source: Leclaire et al. (2021), first challenge on LPT and DA.
    """
    a, b = challenge_pairs(estimate, truth)
    return _counts(a, b, estimate, truth, scored_estimate, scored_truth)


def f1_over_distance(
    estimate: F64, truth: F64, scored_estimate: Bool, scored_truth: Bool, radii: Sequence[float]
) -> F64:
    """Compute F1 by the rule of `count_challenge` over radii in voxels."""
    pairs = (challenge_pairs(estimate, truth, radius) for radius in radii)
    scored = scored_estimate, scored_truth
    return np.array([_counts(i, j, estimate, truth, *scored).f1 for i, j in pairs])


def classify(estimate: F64, truth: F64) -> tuple[U8, I64, I64]:
    """Return the kinds (n,) of detections, and the rows of `challenge_pairs`."""
    kind = np.full(len(estimate), GHOST, dtype=np.uint8)
    if len(estimate) and len(truth):
        apart, _ = cKDTree(truth).query(estimate, p=np.inf)
        kind[apart < CHALLENGE_RADIUS] = DUPLICATE
    i, j = challenge_pairs(estimate, truth)
    kind[i] = FOUND
    return kind, i, j


def challenge_pairs(estimate: F64, truth: F64, radius: float = CHALLENGE_RADIUS) -> tuple[I64, I64]:
    """Pair detections (n, 3) with true particles (m, 3), in voxels.

    Returns the rows of both, equally long, by the challenge's rule.
    """
    if not len(estimate) or not len(truth):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    pairs = cKDTree(estimate).query_ball_tree(cKDTree(truth), radius, p=np.inf)
    left = np.repeat(np.arange(len(pairs)), [len(near) for near in pairs])
    right = np.fromiter((row for near in pairs for row in near), dtype=np.int64, count=len(left))
    offset = estimate[left] - truth[right]
    close = np.abs(offset).max(axis=1) < radius
    order = np.argsort(np.linalg.norm(offset[close], axis=1), kind="stable")
    left, right = left[close][order], right[close][order]
    free_left, free_right = [True] * len(estimate), [True] * len(truth)
    rows = []
    for i, (a, b) in enumerate(zip(left.tolist(), right.tolist(), strict=True)):
        if free_left[a] and free_right[b]:
            free_left[a] = free_right[b] = False
            rows.append(i)
    return left[rows], right[rows]


def _counts(
    a: I64, b: I64, estimate: F64, truth: F64, scored_estimate: Bool, scored_truth: Bool
) -> Counts:
    """Count over the scored part; a pair lies where its true particle does."""
    inside = scored_truth[b]
    offset = estimate[a[inside]] - truth[b[inside]]
    alone = scored_estimate.copy()
    alone[a] = False
    matched = int(inside.sum())
    rms = float(np.sqrt(np.mean(np.sum(offset**2, axis=1)))) if matched else None
    return Counts(int(scored_truth.sum()), matched + int(alone.sum()), matched, rms)


def ghost_ratio(ppp: float, cameras: int, area_px: float, depth_voxels: float) -> float:
    """Compute ghosts per particle, N_g / N_p = ppp^(N - 1) A_p^N l_z.

    Equation 3.14 of the thesis.

    A voxel is lit by chance in N independent images that particles of area A_p cover to the share
    ppp A_p: (ppp A_p)^N of all voxels, with l_z / ppp voxels for each particle. It counts
    voxels, where a ghost has several, and any overlap of lines of sight.

    Parameters
    ----------
    ppp : particles per pixel.
    cameras : N.
    area_px : A_p, area of a particle's image in pixels.
    depth_voxels : l_z.
    """
    return float(ppp ** (cameras - 1) * area_px**cameras * depth_voxels)
