"""Figures 5-15 to 5-17: size distributions of bubbles found in three jets.

The scenes were built to the thesis's ranges of sizes, which are measurements of its own jets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sabench.evaluation.thesis.chapter_5 import (
    FRAMES,
    JetFrames,
    detect_jets,
    jet_rows,
    true_bubbles,
)
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.metrics.averages import finite_or_none, ratio
from sabench.metrics.bubble_detection import AnyBubbles
from sabench.metrics.size_distributions import counts_per_frame, sauter_mm, size_scores
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.arrays import F64

SEEDS = 10
_BIN_MM = 0.1
_SMALL_MM = 1.5  # diameter: figure 5-17b has many below
_ELLIPSES = 43  # mm: the height at which the thesis fits ellipses
_SCORES = {
    "sizes_mm": "distance of size distributions, mm",
    "sizes_percent": "distance over the mean radius, %",
    "mean_percent": "error of the mean radius, %",
    "sauter_percent": "error of the Sauter mean diameter, %",
}


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure sizes and scores of size distributions per jet.

    Scores are means over frames.
    """
    panels = []
    for jet in detect_jets(seeds, pixels):
        panels.append(_panel(jet))
        yield from _scores(jet)
        yield from _ranges(jet)
        yield _small(jet)
        yield _intervals(jet)
    yield Figure("fig-5-15", "bubbles per frame, 95 % intervals", tuple(panels), inch=(4.4, 3.4))


def _radii(every: Sequence[AnyBubbles]) -> list[F64]:
    return [one.radius_mm for one in every]


def _edges(jet: JetFrames) -> F64:
    largest = max(float(radii.max(initial=0.0)) for radii in _radii(jet.true + jet.found))
    return np.arange(0.0, largest + _BIN_MM, _BIN_MM)


def _scores(jet: JetFrames) -> Iterator[Item]:
    frames = [
        size_scores(found, true)
        for found, true in zip(_radii(jet.found), _radii(jet.true), strict=True)
    ]
    for key, name in _SCORES.items():
        values = [one[key] for one in frames if np.isfinite(one[key])]
        yield make_row(f"h = {jet.height} mm: {name}", None, values)


def _ranges(jet: JetFrames) -> Iterator[Item]:
    """Compare the smallest and the largest size, and means of all frames together.

    Sizes are radii, or semi-axes where the thesis fits ellipses.
    """
    every = jet.found, jet.true, true_bubbles(jet.scene, FRAMES)
    radii = [np.concatenate(_radii(frames)) for frames in every]
    if not len(radii[0]):
        return
    what, sizes = "radius", radii
    if jet.height == _ELLIPSES:
        what = "semi-axis"
        sizes = [np.concatenate([one.semi_axes_mm.ravel() for one in frames]) for frames in every]
    least, most = jet.printed.axes_mm
    name = f"h = {jet.height} mm: "
    yield from jet_rows(f"{name}smallest {what}, mm", least, *[one.min() for one in sizes])
    yield from jet_rows(f"{name}largest {what}, mm", most, *[one.max() for one in sizes])
    yield from jet_rows(f"{name}mean radius, mm", None, *[one.mean() for one in radii[:2]])
    d32 = [sauter_mm(one) for one in radii[:2]]
    yield from jet_rows(f"{name}Sauter mean diameter, mm", None, *d32)


def _small(jet: JetFrames) -> Item:
    own, there = (np.concatenate(_radii(every)) for every in (jet.found, jet.true))
    share, true = (
        ratio(int(np.sum(2.0 * radii < _SMALL_MM)), len(radii)) for radii in (own, there)
    )
    return claim(
        f"h = {jet.height} mm: share of diameters below {_SMALL_MM} mm",
        "more small bubbles than large",
        finite_or_none(share),
        share > 0.5,
        f"true bubbles {true:.3f}",
    )


def _intervals(jet: JetFrames) -> Item:
    """Count bins whose interval of found bubbles contains the true mean.

    Both are of the same frames.
    """
    edges = _edges(jet)
    found, true = (counts_per_frame(_radii(every), edges) for every in (jet.found, jet.true))
    held = [
        abs(own.mean - there.mean) <= (own.half_width or 0.0)
        for own, there in zip(found, true, strict=True)
        if own.mean or there.mean
    ]
    row = make_row(
        f"h = {jet.height} mm: share of bins of {_BIN_MM} mm with the true count in the interval",
        None,
        [float(np.mean(held))],
        f"{len(held)} bins, {len(jet.found)} frames",
    )
    return replace(row, seeds=len(jet.found))


def _panel(jet: JetFrames) -> Panel:
    edges = _edges(jet)
    middle = list((edges[1:] + edges[:-1]) / 2.0)
    curves = []
    for name, every in (("found", jet.found), ("true", jet.true)):
        means = counts_per_frame(_radii(every), edges)
        spread = [mean.half_width or 0.0 for mean in means] if name == "found" else None
        curves.append(Curve(name, middle, [mean.mean for mean in means], spread))
    return Panel(f"h = {jet.height} mm", "radius, mm", "bubbles per frame", tuple(curves))
