"""Figures 5-23 to 5-25: sizes of bubbles above and below the penetration depth.

The largest diameter below it follows from the terminal velocity of bubbles (5-23).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_5 import JetFrames, detect_jets, jet_rows
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.metrics.bubble_detection import AnyBubbles
from sabench.metrics.plunging_jet import DEPTH_MM
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.utils.arrays import F64
from sabench.worlds.library.rise_velocity import (
    Liquid,
    terminal_velocity,
    transition_diameter_mm,
)

SEEDS = 10
_WATER = Liquid()
_CUTOFF_MM = 1.05  # diameter that the thesis reads off figure 5-23
_LARGEST_MM = {21: 4.88, 43: 8.64}  # diameters that it starts from
_BIN_MM = 0.25  # of diameter
_LEAST_RE = 20.0  # of the curves that are drawn: the law is that of thin boundary layers


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Compute the transition diameter, and measure sizes above and below Y_p."""
    for height, largest in _LARGEST_MM.items():
        yield make_row(
            f"h = {height} mm: transition diameter, mm",
            _CUTOFF_MM,
            [transition_diameter_mm(largest, _WATER)],
            f"largest diameter {largest} mm; Moore (1965) and Clift et al. (1978) instead of the "
            "curve of Maxworthy et al., from which the thesis reads",
        )
    yield _law()
    for jet in detect_jets(seeds, pixels):
        if jet.height in _LARGEST_MM:
            yield from _below(jet)


def _below(jet: JetFrames) -> Iterator[Item]:
    """Compare sizes above Y_p with those in the two bins below.

    Both sides of the true Y_p of the scene count, as found and true bubbles share it.
    """
    middle = jet.printed.penetration_mm
    found, true = (_shares(jet, every, middle) for every in (jet.found, jet.true))
    name = f"h = {jet.height} mm: share of diameters above {_CUTOFF_MM} mm, %, "
    yield from jet_rows(f"{name}above Y_p", None, found[0], true[0])
    yield from jet_rows(f"{name}in two bins below", None, found[1], true[1])
    yield claim(
        f"h = {jet.height} mm: that share below over that above Y_p",
        "a sharp drop of large bubbles",
        found[1] / found[0] if found[0] else None,
        found[1] < 0.1 * found[0],
        "the thesis gives no number; here less than a tenth",
    )
    yield _figure(jet)


def _positions(jet: JetFrames, every: Sequence[AnyBubbles]) -> tuple[F64, F64]:
    """Return depths below the surface and diameters (n,) of all bubbles in mm."""
    return (
        np.concatenate([one.center_mm[:, 1] for one in every]) - jet.impact_mm[1],
        np.concatenate([2.0 * one.radius_mm for one in every]),
    )


def _shares(jet: JetFrames, every: Sequence[AnyBubbles], middle: float) -> tuple[float, float]:
    y, diameter = _positions(jet, every)
    sides = y < middle, (y >= middle) & (y < middle + 2.0 * DEPTH_MM)
    above, below = (
        100.0 * float(np.mean(diameter[side] > _CUTOFF_MM)) if side.any() else float("nan")
        for side in sides
    )
    return above, below


def _law() -> Figure:
    """Draw figure 5-23: terminal velocity over diameter, for several Morton numbers."""
    d = np.geomspace(0.3, 20.0, 200)
    curves = []
    for viscosity in (0.5e-6, 1e-6, 2e-6):
        liquid = Liquid(viscosity=viscosity)
        u = terminal_velocity(d, liquid)
        good = u * 1e-3 * d > _LEAST_RE * viscosity  # not where u is NaN
        curves.append(Curve(f"Mo = {liquid.morton:.2g}", list(d[good]), list(u[good])))
    panel = Panel("", "diameter, mm", "terminal velocity, m/s", tuple(curves), log="xy")
    return Figure("fig-5-23", "terminal velocity of single bubbles", (panel,))


def _figure(jet: JetFrames) -> Figure:
    """Draw distributions of found bubbles in bins of depth above and below Y_p."""
    y, diameter = _positions(jet, jet.found)
    depths = np.arange(0.0, float(y.max(initial=0.0)) + DEPTH_MM, DEPTH_MM)
    sizes = np.arange(0.0, float(diameter.max(initial=0.0)) + _BIN_MM, _BIN_MM)
    counts, *_ = np.histogram2d(y, diameter, bins=(depths, sizes))
    x, depth = (edges[:-1] + np.diff(edges) / 2.0 for edges in (sizes, depths))
    first = int(np.searchsorted(depth, jet.printed.penetration_mm))
    panels = []
    for title, bins in (
        ("above Y_p", range(max(first - 3, 0), first)),
        ("below Y_p", range(first, min(first + 2, len(depth)))),
    ):
        curves = tuple(
            Curve(f"Y = {depth[n]:.0f} mm", list(x), list(counts[n] / len(jet.found))) for n in bins
        )
        panels.append(Panel(title, "diameter, mm", "bubbles per frame", curves))
    number = {21: "5-24", 43: "5-25"}[jet.height]
    return Figure(f"fig-{number}", f"found bubbles, h = {jet.height} mm", tuple(panels))
