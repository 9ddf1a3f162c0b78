"""Detected bubbles against true ones: matching, counts, errors, sizes."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sabench.api import Detections
from sabench.api.truth import Bubbles
from sabench.metrics.averages import ratio
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.confidence import Mean, mean_of


def sauter_mm(radius_mm: F64) -> float:
    """Compute the Sauter mean diameter d32 = sum of d^3 / sum of d^2 from radii (n,).

    It is the diameter of the ball with the ratio of volume to surface of all bubbles together. NaN
    without bubbles.
    """
    square = float(np.sum(radius_mm**2))
    return 2.0 * float(np.sum(radius_mm**3)) / square if square else float("nan")


def size_scores(own_mm: F64, true_mm: F64) -> dict[str, float]:
    """Score radii (n,) as a distribution against true radii (m,).

    NaN where either has none.
    `sizes_mm` is the first Wasserstein distance: the mean difference of radii of equal rank, which
    moves one distribution onto the other. `sizes_percent` is the same over the true mean radius.
    `mean_percent` and `sauter_percent` are errors, regardless of sign, of mean radius and d32.
    """
    from scipy.stats import wasserstein_distance  # takes long to load

    keys = ("sizes_mm", "sizes_percent", "mean_percent", "sauter_percent")
    if not len(own_mm) or not len(true_mm):
        return dict.fromkeys(keys, float("nan"))
    distance, mean = float(wasserstein_distance(own_mm, true_mm)), float(true_mm.mean())
    return {
        "sizes_mm": distance,
        "sizes_percent": 100.0 * distance / mean,
        "mean_percent": 100.0 * abs(float(own_mm.mean()) / mean - 1.0),
        "sauter_percent": 100.0 * abs(sauter_mm(own_mm) / sauter_mm(true_mm) - 1.0),
    }


def counts_per_frame(radii_mm: Sequence[F64], edges_mm: F64) -> list[Mean]:
    """Count bubbles per bin of radius and frame.

    The 95 % confidence intervals are over the frames.

    Parameters
    ----------
    radii_mm : radii (n,) of each frame.
    edges_mm : (bins + 1,) edges of the bins, rising.

    Raises ValueError: no frame.
    """
    if not len(radii_mm):
        raise ValueError("radii_mm: expected those of one frame or more, got none")
    counts = np.array([np.histogram(frame, edges_mm)[0] for frame in radii_mm], dtype=np.float64)
    means = [mean_of(list(column)) for column in counts.T]
    return [mean for mean in means if mean is not None]


LARGE_MM = 0.5  # radius of what counts as a large bubble
HIDDEN = 0.9  # visible fraction of a bubble, mean over the cameras, below which it is hidden
AROUND_MM = 6.0  # radius around a bubble for the volume of others
DENSE = 0.01  # least void fraction of the others around a bubble in a dense place
FLAT = 0.9  # short over long axis below which the direction of the short axis has a meaning
NEAR = 0.5  # of a true bubble's radius

AnyBubbles = Detections | Bubbles


def match_bubbles(estimate_mm: F64, truth_mm: F64, radius_mm: F64) -> tuple[I64, I64]:
    """Match detected and true bubbles one to one.

    Pairs are as many as possible, and as close as possible.

    Parameters
    ----------
    estimate_mm, truth_mm : centres (n, 3) and (m, 3).
    radius_mm : (m,) true radii; a pair is closer than half of it.

    Returns rows of the detected and of the true ones, equally long.
    """
    near: Sequence[Sequence[int]] = []
    if len(estimate_mm) and len(truth_mm):
        near = cKDTree(estimate_mm).query_ball_point(truth_mm, NEAR * radius_mm)
    pairs = np.array([(i, j) for j, rows in enumerate(near) for i in rows], dtype=np.int64)
    if not len(pairs):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    distance = np.linalg.norm(estimate_mm[pairs[:, 0]] - truth_mm[pairs[:, 1]], axis=1)
    ends = pairs + np.array([0, len(estimate_mm)])
    size = len(estimate_mm) + len(truth_mm)
    links = coo_matrix((np.ones(len(pairs)), tuple(ends.T)), shape=(size, size))
    cluster = connected_components(links)[1][pairs[:, 0]]
    order = np.argsort(cluster, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1)
    both = np.concatenate([_assign(pairs[group], distance[group]) for group in groups])
    return both[:, 0], both[:, 1]


def _assign(pairs: I64, distance: F64) -> I64:
    """Select the best one-to-one pairs of one cluster."""
    if len(pairs) == 1:
        return pairs
    rows, row = np.unique(pairs[:, 0], return_inverse=True)
    columns, column = np.unique(pairs[:, 1], return_inverse=True)
    far = 1e3 * float(distance.max() + 1.0)
    cost = np.full((len(rows), len(columns)), far)
    cost[row, column] = distance
    i, j = linear_sum_assignment(cost)
    good = cost[i, j] < far
    return np.column_stack([rows[i[good]], columns[j[good]]])


def detection_scores(estimate: AnyBubbles, truth: AnyBubbles, visible: F64) -> dict[str, float]:
    """Score the bubbles of one frame; NaN where there is nothing to count.

    Parameters
    ----------
    visible : (n,) fraction of each true bubble that the cameras see, mean over them.
    """
    i, j = match_bubbles(estimate.center_mm, truth.center_mm, truth.radius_mm)
    large = truth.radius_mm[j] >= LARGE_MM
    air, true_air = (
        4.0 / 3.0 * np.pi * float(one.semi_axes_mm.prod(axis=1).sum()) for one in (estimate, truth)
    )
    return (
        _counts(estimate, truth, visible, i, j)
        | _errors(estimate, truth, i[large], j[large])
        | size_scores(estimate.radius_mm, truth.radius_mm)
        | {"void_percent": 100.0 * abs(air - true_air) / true_air if true_air else np.nan}
    )


def _counts(
    estimate: AnyBubbles, truth: AnyBubbles, visible: F64, i: I64, j: I64
) -> dict[str, float]:
    """Compute F1 scores, precision and recall from the rows of matched bubbles.

    A false detection counts as large if the true bubble nearest to it is large, so that no F1 score
    depends on the radii that an estimate chooses.
    """
    hit = np.zeros(len(truth.center_mm), dtype=np.bool_)
    ghost = np.ones(len(estimate.center_mm), dtype=np.bool_)
    hit[j], ghost[i] = True, False
    large = truth.radius_mm >= LARGE_MM
    every = np.ones(len(large), dtype=np.bool_)
    near_large = large[nearest_bubble(truth, estimate.center_mm[ghost])]
    return {
        "f1": _f1(hit, every, int(ghost.sum())),
        "f1_large": _f1(hit, large, int(near_large.sum())),
        "f1_small": _f1(hit, ~large, int((~near_large).sum())),
        "precision": ratio(len(i), len(estimate.center_mm)),
        "recall": ratio(len(j), len(truth.center_mm)),
        "recall_hidden": _recall(hit, visible < HIDDEN),
        "recall_dense": _recall(hit, crowding(truth) >= DENSE),
    }


def nearest_bubble(bubbles: AnyBubbles, points_mm: F64) -> I64:
    """Find the bubble (n,) with the cell of the power diagram around each point.

    The answer is empty if there is no bubble. The cell of a bubble holds the points where
    distance^2 - radius^2 is smallest: all points inside it, if it overlaps no other one. With the
    heights below, that is the nearest neighbour in four dimensions. Source: Aurenhammer, "Power
    diagrams", SIAM J. Comput. 16 (1987).
    """
    if not len(bubbles.center_mm):
        return np.zeros(0, dtype=np.int64)
    radius = bubbles.radius_mm
    height = np.sqrt(radius.max() ** 2 - radius**2)
    lifted = np.column_stack([bubbles.center_mm, height])
    points = np.column_stack([points_mm, np.zeros(len(points_mm))])
    return np.asarray(cKDTree(lifted).query(points)[1], dtype=np.int64)


def crowding(bubbles: AnyBubbles) -> F64:
    """Compute the void fraction (n,) of others within `AROUND_MM`."""
    volume = np.asarray(4.0 / 3.0 * np.pi * bubbles.semi_axes_mm.prod(axis=1))
    if not len(volume):
        return volume
    near = cKDTree(bubbles.center_mm).query_ball_point(bubbles.center_mm, AROUND_MM)
    others = np.array([volume[group].sum() for group in near]) - volume
    return np.asarray(others / (4.0 / 3.0 * np.pi * AROUND_MM**3))


def _recall(hit: Bool, selected: Bool) -> float:
    return ratio(int(hit[selected].sum()), int(selected.sum()))


def _f1(hit: Bool, selected: Bool, ghosts: int) -> float:
    true, missed = int(hit[selected].sum()), int((~hit[selected]).sum())
    return ratio(2 * true, 2 * true + missed + ghosts)


def _errors(estimate: AnyBubbles, truth: AnyBubbles, i: I64, j: I64) -> dict[str, float]:
    """Compute median errors of matched pairs."""
    keys = ("radius_percent", "axes_percent", "tilt_deg", "plane_mm", "depth_mm")
    if not len(i):
        return dict.fromkeys(keys, float("nan"))
    off = estimate.center_mm[i] - truth.center_mm[j]
    radius = np.abs(estimate.radius_mm[i] / truth.radius_mm[j] - 1.0)
    axes, true_axes = estimate.semi_axes_mm[i], truth.semi_axes_mm[j]
    stretch = np.abs(np.sort(axes, axis=1) / np.sort(true_axes, axis=1) - 1.0).mean(axis=1)
    shortest = estimate.turn[i, axes.argmin(axis=1)]
    true_shortest = truth.turn[j, true_axes.argmin(axis=1)]
    cosine = np.clip(np.abs(np.sum(shortest * true_shortest, axis=1)), 0.0, 1.0)
    flat = true_axes.min(axis=1) < FLAT * true_axes.max(axis=1)
    tilt = np.rad2deg(np.arccos(cosine))[flat]
    figures = (
        100.0 * float(np.median(radius)),
        100.0 * float(np.median(stretch)),
        float(np.median(tilt)) if len(tilt) else float("nan"),
        float(np.median(np.linalg.norm(off[:, :2], axis=1))),
        float(np.median(np.abs(off[:, 2]))),
    )
    return dict(zip(keys, figures, strict=True))
