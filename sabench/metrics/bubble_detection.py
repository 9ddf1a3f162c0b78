"""Found bubbles against true ones: which is which, and how far off sizes and places are."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import wasserstein_distance

from sabench.api import Detections
from sabench.api.truth import Bubbles
from sabench.utils.arrays import F64, I64, Bool

LARGE_MM = 0.5  # radius of what counts as a large bubble
HIDDEN = 0.9  # seen part of a bubble, mean over the cameras, below which it counts as hidden
AROUND_MM, DENSE = (
    6.0,
    0.01,
)  # radius in which others' volume is counted, and the part of it from which a bubble is among many
FLAT = 0.9  # short over long axis below which a direction has a meaning
_NEAR = 0.5  # of a true bubble's radius

AnyBubbles = Detections | Bubbles


def match(found_mm: F64, true_mm: F64, radius_mm: F64) -> tuple[I64, I64]:
    """Pairs of found and true bubbles, one to one, closer than half the true radius, as many as possible and as close as possible.

    Returns
    -------
    Rows of the found and of the true ones, equally long.
    """
    near = (
        cKDTree(found_mm).query_ball_point(true_mm, _NEAR * radius_mm)
        if len(found_mm) and len(true_mm)
        else []
    )
    pairs = np.array(
        [(i, j) for j, group in enumerate(near) for i in group], dtype=np.int64
    ).reshape(-1, 2)
    if not len(pairs):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    distance = np.linalg.norm(found_mm[pairs[:, 0]] - true_mm[pairs[:, 1]], axis=1)
    size = len(found_mm) + len(true_mm)
    _, label = connected_components(
        coo_matrix(
            (np.ones(len(pairs)), (pairs[:, 0], len(found_mm) + pairs[:, 1])), shape=(size, size)
        ),
        directed=False,
    )
    which = label[pairs[:, 0]]
    order = np.argsort(which, kind="stable")
    chosen = [
        _assigned(pairs[group], distance[group])
        for group in np.split(order, np.flatnonzero(np.diff(which[order])) + 1)
    ]
    both = np.concatenate(chosen)
    return both[:, 0], both[:, 1]


def _assigned(pairs: I64, distance: F64) -> I64:
    """The best one-to-one choice among the pairs of one cluster."""
    if len(pairs) == 1:
        return pairs
    rows, columns = np.unique(pairs[:, 0]), np.unique(pairs[:, 1])
    far = 1e3 * float(distance.max() + 1.0)
    cost = np.full((len(rows), len(columns)), far)
    cost[np.searchsorted(rows, pairs[:, 0]), np.searchsorted(columns, pairs[:, 1])] = distance
    i, j = linear_sum_assignment(cost)
    good = cost[i, j] < far
    return np.column_stack([rows[i[good]], columns[j[good]]])


def detection_scores(found: AnyBubbles, true: AnyBubbles, seen: F64) -> dict[str, float]:
    """All figures of one frame; NaN where there is nothing to count.

    Parameters
    ----------
    seen : (n,) part of each true bubble that the cameras see, mean over them.
    """
    i, j = match(found.center_mm, true.center_mm, true.radius_mm)
    hit_true, hit_found = (
        np.zeros(len(true.center_mm), dtype=np.bool_),
        np.zeros(len(found.center_mm), dtype=np.bool_),
    )
    hit_true[j], hit_found[i] = True, True
    large = true.radius_mm >= LARGE_MM
    every = np.ones(len(large), dtype=np.bool_)
    ghosts = found.radius_mm[~hit_found]
    scores = {
        "f1": _f1(hit_true, every, len(ghosts)),
        "f1_large": _f1(hit_true, large, int((ghosts >= LARGE_MM).sum())),
        "f1_small": _f1(hit_true, ~large, int((ghosts < LARGE_MM).sum())),
        "precision": _part(len(i), len(found.center_mm)),
        "recall": _part(len(j), len(true.center_mm)),
        "recall_hidden": _recall(hit_true, seen < HIDDEN),
        "recall_dense": _recall(hit_true, crowding(true) >= DENSE),
    }
    big = large[j]
    scores |= _errors(found, true, i[big], j[big])
    both = len(found.radius_mm) and len(true.radius_mm)
    apart = (
        float(wasserstein_distance(found.radius_mm, true.radius_mm) / true.radius_mm.mean())
        if both
        else np.nan
    )
    scores["sizes_percent"] = 100.0 * apart
    air, known = (
        4.0 / 3.0 * np.pi * float(one.semi_axes_mm.prod(axis=1).sum()) for one in (found, true)
    )
    scores["void_percent"] = 100.0 * abs(air - known) / known if known else np.nan
    return scores


def crowding(bubbles: AnyBubbles) -> F64:
    """Void fraction (n,) that the others make around each bubble's centre, by whose centres are within `AROUND_MM`."""
    volume = np.asarray(4.0 / 3.0 * np.pi * bubbles.semi_axes_mm.prod(axis=1))
    if not len(volume):
        return volume
    near = cKDTree(bubbles.center_mm).query_ball_point(bubbles.center_mm, AROUND_MM)
    others = np.array([volume[group].sum() for group in near]) - volume
    return np.asarray(others / (4.0 / 3.0 * np.pi * AROUND_MM**3))


def _recall(hit: Bool, chosen: Bool) -> float:
    return _part(int(hit[chosen].sum()), int(chosen.sum()))


def _f1(hit: Bool, chosen: Bool, ghosts: int) -> float:
    true, missed = int(hit[chosen].sum()), int((~hit[chosen]).sum())
    return _part(2 * true, 2 * true + missed + ghosts)


def _part(count: int, whole: int) -> float:
    return count / whole if whole else float("nan")


def _errors(found: AnyBubbles, true: AnyBubbles, i: I64, j: I64) -> dict[str, float]:
    """Medians over pairs."""
    if not len(i):
        return dict.fromkeys(
            ("radius_percent", "axes_percent", "tilt_deg", "plane_mm", "depth_mm"), float("nan")
        )
    off = found.center_mm[i] - true.center_mm[j]
    radius = np.abs(found.radius_mm[i] / true.radius_mm[j] - 1.0)
    axes = np.abs(
        np.sort(found.semi_axes_mm[i], axis=1) / np.sort(true.semi_axes_mm[j], axis=1) - 1.0
    ).mean(axis=1)
    flat = true.semi_axes_mm[j].min(axis=1) < FLAT * true.semi_axes_mm[j].max(axis=1)
    tilt = np.rad2deg(
        np.arccos(
            np.clip(np.abs(np.sum(short_axis(found, i) * short_axis(true, j), axis=1)), 0.0, 1.0)
        )
    )[flat]
    return {
        "radius_percent": 100.0 * float(np.median(radius)),
        "axes_percent": 100.0 * float(np.median(axes)),
        "tilt_deg": float(np.median(tilt)) if len(tilt) else float("nan"),
        "plane_mm": float(np.median(np.linalg.norm(off[:, :2], axis=1))),
        "depth_mm": float(np.median(np.abs(off[:, 2]))),
    }


def short_axis(bubbles: AnyBubbles, which: I64) -> F64:
    """Unit vectors (n, 3) along the shortest axes."""
    return np.asarray(bubbles.turn[which, bubbles.semi_axes_mm[which].argmin(axis=1)])
