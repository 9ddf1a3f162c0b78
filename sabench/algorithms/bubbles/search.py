"""Choice of the hypotheses that are bubbles.

The best are fitted first, and the others are fitted to the darkness that is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from sabench.algorithms.bubbles.backlit_profile import Profile
from sabench.algorithms.bubbles.hypotheses import Hypotheses
from sabench.algorithms.bubbles.rim_fit import (
    Model,
    darken,
    ellipses_of,
    fit,
    gain,
    misfit,
    unexplained,
)
from sabench.algorithms.bubbles.spheroids import semi_axes_of, start_of, turn_of
from sabench.api import Detections
from sabench.geometry.camera import Camera
from sabench.utils.arrays import F32, F64
from sabench.utils.progress import progress_bar

_FIRST, _MORE = 8, 6  # steps of a fit
_ANGLES = np.deg2rad(np.geomspace(6.0, 70.0, 26))
_LIKELY, _LARGEST, _CLEAN = (
    0.7,
    32,
    12,
    # part of the most votes; bubbles that may tell the diffuser, and those that do: nothing else is
    # there
)
_SURE, _WORTH = (
    0.75,
    0.25,
)  # gain of what goes first; part of the least gain that makes a fit worth while
_VOTED, _SMALLER, _SIMPLER = (
    0.5,
    0.75,
    0.1,
)  # votes of what may replace others; their radius over its; misfit that each of them is worth


class Limits(NamedTuple):
    """Conditions that a fit must meet to count as a bubble.

    Attributes
    ----------
    smallest_mm, largest_mm : radius of a ball of the same volume.
    least_gain : part of its shadow that must be dark and not explained by others, median over the
        views.
    """

    smallest_mm: float
    largest_mm: float
    least_gain: float


def search_bubbles(
    images: F32,
    cameras: Sequence[Camera],
    profile_of: Callable[[float], Profile],
    half_angle: float | None,
    start: Hypotheses,
    limits: Limits,
    sweeps: int,
) -> Detections:
    """Find bubbles that explain the dark parts of images (camera, row, column).

    Parameters
    ----------
    profile_of : profile of a bubble in front of a diffuser of a half angle (rad).
    half_angle : of the diffuser seen from the bubbles; None: the one that fits the largest bubbles
        best.
    limits : what is a bubble. A fit that becomes smaller is the rest of another bubble's shadow.
    sweeps : number of times that all bubbles are fitted again, each with the others in place.
    """
    if half_angle is None:
        half_angle = _lit_from(images, cameras, profile_of, start)
    model = Model(images, np.zeros_like(images), cameras, profile_of(half_angle))
    kept = _unite(model, _accept(model, start, limits), start, limits)
    for _ in range(sweeps):
        kept = _refine(model, kept, limits)
    return _detections(kept)


def _lit_from(
    images: F32,
    cameras: Sequence[Camera],
    profile_of: Callable[[float], Profile],
    start: Hypotheses,
) -> float:
    """Find the diffuser's half angle that fits the likeliest bubbles best.

    Only the largest of these are fitted.
    """
    likely = np.flatnonzero(start.vote >= _LIKELY * start.vote.max(initial=0.0))
    chosen = likely[np.argsort(-start.radius_mm[likely], kind="stable")][:_LARGEST]
    costs = np.zeros((len(_ANGLES), len(chosen)))
    for row, angle in zip(costs, progress_bar(_ANGLES.tolist(), "find the diffuser"), strict=True):
        model = Model(images, np.zeros_like(images), cameras, profile_of(angle))
        row[:] = [misfit(model, fit(model, _start(start, n), _FIRST)) for n in chosen]
    clean = np.argsort(costs.min(axis=0), kind="stable")[:_CLEAN]
    return (
        float(_ANGLES[costs[:, clean].sum(axis=1).argmin()])
        if len(chosen)
        else float(_ANGLES[len(_ANGLES) // 2])
    )


def _accept(model: Model, start: Hypotheses, limits: Limits) -> list[F64]:
    """Fit and judge hypotheses in the order of their gains."""
    order = np.argsort(-start.vote * start.radius_mm, kind="stable")
    kept: list[F64] = []
    for least in (
        max(_SURE, limits.least_gain),
        limits.least_gain,
    ):  # what is sure goes first: a large bubble before the small ones that its rim could be
        for n in progress_bar(order.tolist(), "fit bubbles"):
            first = _start(start, n)
            if _median_gain(model, first) < _WORTH * least:
                continue
            fitted = fit(model, first, _FIRST)
            if _is_bubble(model, fitted, limits._replace(least_gain=least)):
                darken(model, fitted, 1.0)
                kept.append(fitted)
    return kept


def _unite(model: Model, kept: list[F64], start: Hypotheses, limits: Limits) -> list[F64]:
    """Replace small bubbles along one rim by one bubble.

    A replacement must explain the images as well as they do.
    """
    order = [
        n
        for n in np.argsort(-start.radius_mm * start.aspect, kind="stable").tolist()
        if start.vote[n] >= _VOTED
    ]
    for n in progress_bar(order, "unite bubbles"):
        first = _start(start, n)
        parts = _parts(kept, first)
        if not parts:
            continue
        before = unexplained(model, ellipses_of(model, first))
        for one in parts:
            darken(model, kept[one], -1.0)
        whole = fit(model, first, _FIRST)
        good = _is_bubble(model, whole, limits) and set(_parts(kept, whole)) >= set(parts)
        if good:
            darken(model, whole, 1.0)
            good = unexplained(model, ellipses_of(model, first)) < before * (
                1.0 + _SIMPLER * (len(parts) - 1)
            )
            if not good:
                darken(model, whole, -1.0)
        if good:
            kept = [one for k, one in enumerate(kept) if k not in parts] + [whole]
        else:
            for one in parts:
                darken(model, kept[one], 1.0)
    return kept


def _parts(kept: list[F64], whole: F64) -> list[int]:
    """List the bubbles that are smaller than another one and within its outline.

    The list is empty if a similar bubble exists already.
    """
    if not kept:
        return []
    every = np.stack(kept)
    radius, own = np.exp(every[:, 3:5]).max(axis=1), float(np.exp(whole[3]))
    across, along = np.linalg.norm(every[:, :2] - whole[:2], axis=1), np.abs(every[:, 2] - whole[2])
    if ((across < 0.5 * own) & (along < 1.5 * own) & (radius > _SMALLER * own)).any():
        return []
    return np.flatnonzero(
        (across < 1.05 * own) & (along < 2.0 * own) & (radius <= _SMALLER * own)
    ).tolist()


def _start(start: Hypotheses, n: int) -> F64:
    return start_of(start.center_mm[n], float(start.radius_mm[n]), float(start.aspect[n]))


def _is_bubble(model: Model, fitted: F64, limits: Limits) -> bool:
    """Tell whether a fit has a bubble's size, by volume, and explains enough."""
    radius = float(np.exp((2.0 * fitted[3] + fitted[4]) / 3.0))
    return (
        limits.smallest_mm <= radius <= limits.largest_mm
        and _median_gain(model, fitted) >= limits.least_gain
    )


def _median_gain(model: Model, parameters: F64) -> float:
    """Compute the median gain over the views that see a bubble.

    A bubble that fewer than two views see is rejected.
    """
    gains = gain(model, parameters)
    seen = gains[np.isfinite(gains)]
    return float(np.median(seen)) if len(seen) >= 2 else -1.0


def _refine(model: Model, kept: list[F64], limits: Limits) -> list[F64]:
    """Fit all bubbles again and drop those that the others explain by now."""
    out = []
    for parameters in progress_bar(kept, "refine bubbles"):
        darken(model, parameters, -1.0)
        better = fit(model, parameters, _MORE)
        if _is_bubble(model, better, limits):
            darken(model, better, 1.0)
            out.append(better)
    return out


def _detections(kept: list[F64]) -> Detections:
    if not kept:
        return Detections(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    return Detections(
        np.stack([p[:3] for p in kept]),
        semi_axes_of(np.array(kept)),
        turn_of(np.array(kept)),
    )
