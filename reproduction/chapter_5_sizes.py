"""Sizes of bubbles in plunging jets: figures 5-15 to 5-17 and 5-23 to 5-25."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sabench.evaluation.reproduction import Item
from sabench.metrics.averages import finite_or_none, ratio
from sabench.metrics.bubble_detection import AnyBubbles, counts_per_frame, sauter_mm, size_scores
from sabench.metrics.plunging_jet import DEPTH_MM
from sabench.plotting.drawing import Curve, Figure, Panel
from sabench.utils.arrays import F64

from .chapter_5 import FRAMES, JetFrames, detect_jets, jet_rows, true_bubbles
from .common import claim, finite_row, make_row
from .rise_velocity import Liquid, terminal_velocity, transition_diameter_mm

_BIN_MM = 0.1
_SMALL_MM = 1.5  # diameter: figure 5-17b has many below
_ELLIPSES = 43  # mm: the height at which the thesis fits ellipses
_SCORES = {
    "sizes_mm": "distance of size distributions, mm",
    "sizes_percent": "distance over the mean radius, %",
    "mean_percent": "error of the mean radius, %",
    "sauter_percent": "error of the Sauter mean diameter, %",
}


def fig_5_15(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure sizes and scores of size distributions per jet.

    Scores are means over frames. The scenes were built to the thesis's ranges of sizes, which are
    measurements of its own jets.
    """
    panels = []
    for jet in detect_jets(seeds, pixels):
        edges = _edges(jet)
        middle = list((edges[1:] + edges[:-1]) / 2.0)
        curves = []
        for name, every in (("found", jet.found), ("true", jet.true)):
            means = counts_per_frame(_radii(every), edges)
            spread = [mean.half_width or 0.0 for mean in means] if name == "found" else None
            curves.append(Curve(name, middle, [mean.mean for mean in means], spread))
        panels.append(
            Panel(f"h = {jet.height} mm", "radius, mm", "bubbles per frame", tuple(curves))
        )
        yield from _scores(jet)
        yield from _ranges(jet)
        yield _small(jet)
        yield _intervals(jet)
    yield Figure("fig-5-15", "bubbles per frame, 95 % intervals", tuple(panels), inch=(4.4, 3.4))


def _radii(every: Sequence[AnyBubbles]) -> list[F64]:
    return [bubbles.radius_mm for bubbles in every]


def _edges(jet: JetFrames) -> F64:
    largest = max(float(radii.max(initial=0.0)) for radii in _radii(jet.true + jet.found))
    return np.arange(0.0, largest + _BIN_MM, _BIN_MM)


def _scores(jet: JetFrames) -> Iterator[Item]:
    frames = [
        size_scores(estimate, true)
        for estimate, true in zip(_radii(jet.found), _radii(jet.true), strict=True)
    ]
    for key, name in _SCORES.items():
        yield finite_row(f"h = {jet.height} mm: {name}", [score[key] for score in frames])


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
        axes = [[bubbles.semi_axes_mm.ravel() for bubbles in frames] for frames in every]
        sizes = [np.concatenate(part) for part in axes]
    least, most = jet.printed.axes_mm
    name = f"h = {jet.height} mm: "
    yield from jet_rows(f"{name}smallest {what}, mm", least, *[size.min() for size in sizes])
    yield from jet_rows(f"{name}largest {what}, mm", most, *[size.max() for size in sizes])
    yield from jet_rows(f"{name}mean radius, mm", None, *[radius.mean() for radius in radii[:2]])
    d32 = [sauter_mm(radius) for radius in radii[:2]]
    yield from jet_rows(f"{name}Sauter mean diameter, mm", None, *d32)


def _small(jet: JetFrames) -> Item:
    estimated, exact = (np.concatenate(_radii(every)) for every in (jet.found, jet.true))
    share, true = (
        ratio(int(np.sum(2.0 * radii < _SMALL_MM)), len(radii)) for radii in (estimated, exact)
    )
    return claim(
        f"h = {jet.height} mm: share of diameters below {_SMALL_MM} mm",
        "more small bubbles than large",
        finite_or_none(share),
        share > 0.5,
        f"true bubbles {true:.3f}",
    )


def _intervals(jet: JetFrames) -> Item:
    """Count bins with the true mean in the interval of the found bubbles.

    Both are of the same frames.
    """
    edges = _edges(jet)
    estimated, true = (counts_per_frame(_radii(every), edges) for every in (jet.found, jet.true))
    held = [
        abs(count.mean - truth.mean) <= (count.half_width or 0.0)
        for count, truth in zip(estimated, true, strict=True)
        if count.mean or truth.mean
    ]
    row = make_row(
        f"h = {jet.height} mm: share of bins of {_BIN_MM} mm with the true count in the interval",
        None,
        [float(np.mean(held))],
        f"{len(held)} bins, {len(jet.found)} frames",
    )
    return replace(row, seeds=len(jet.found))


_WATER = Liquid()
_CUTOFF_MM = 1.05  # diameter that the thesis reads off figure 5-23
_LARGEST_MM = {21: 4.88, 43: 8.64}  # diameters that it starts from
_WIDE_BIN_MM = 0.25  # of diameter
_LEAST_RE = 20.0  # of the curves that are drawn: the law is that of thin boundary layers


def fig_5_24(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Compute the transition diameter, and measure sizes above and below Y_p.

    The largest diameter below it follows from the terminal velocity of bubbles (5-23).
    """
    for height, largest in _LARGEST_MM.items():
        yield make_row(
            f"h = {height} mm: transition diameter, mm",
            _CUTOFF_MM,
            [transition_diameter_mm(largest, _WATER)],
            f"largest diameter {largest} mm; Moore (1965) and Clift et al. (1978) instead of the "
            "curve of Maxworthy et al., from which the thesis reads",
        )
    # draw figure 5-23: terminal velocity over diameter, for several Morton numbers
    d = np.geomspace(0.3, 20.0, 200)
    curves = []
    for viscosity in (0.5e-6, 1e-6, 2e-6):
        liquid = Liquid(viscosity=viscosity)
        u = terminal_velocity(d, liquid)
        good = u * 1e-3 * d > _LEAST_RE * viscosity  # not where u is NaN
        curves.append(Curve(f"Mo = {liquid.morton:.2g}", list(d[good]), list(u[good])))
    panel = Panel("", "diameter, mm", "terminal velocity, m/s", tuple(curves), log="xy")
    yield Figure("fig-5-23", "terminal velocity of single bubbles", (panel,))
    for jet in detect_jets(seeds, pixels):
        if jet.height in _LARGEST_MM:
            # compare sizes above Y_p with those in the two bins below. Both sides of the true Y_p
            # of the scene count, as found and true bubbles share it
            middle = jet.printed.penetration_mm
            estimated, true = (_shares(jet, every, middle) for every in (jet.found, jet.true))
            name = f"h = {jet.height} mm: share of diameters above {_CUTOFF_MM} mm, %, "
            yield from jet_rows(f"{name}above Y_p", None, estimated[0], true[0])
            yield from jet_rows(f"{name}in two bins below", None, estimated[1], true[1])
            yield claim(
                f"h = {jet.height} mm: that share below over that above Y_p",
                "a sharp drop of large bubbles",
                estimated[1] / estimated[0] if estimated[0] else None,
                estimated[1] < 0.1 * estimated[0],
                "the thesis gives no number; here less than a tenth",
            )
            yield _figure(jet)


def _positions(jet: JetFrames, every: Sequence[AnyBubbles]) -> tuple[F64, F64]:
    """Return depths below the surface and diameters (n,) of all bubbles in mm."""
    return (
        np.concatenate([bubbles.center_mm[:, 1] for bubbles in every]) - jet.impact_mm[1],
        np.concatenate([2.0 * bubbles.radius_mm for bubbles in every]),
    )


def _shares(jet: JetFrames, every: Sequence[AnyBubbles], middle: float) -> tuple[float, float]:
    y, diameter = _positions(jet, every)
    sides = y < middle, (y >= middle) & (y < middle + 2.0 * DEPTH_MM)
    above, below = (
        100.0 * float(np.mean(diameter[side] > _CUTOFF_MM)) if side.any() else float("nan")
        for side in sides
    )
    return above, below


def _figure(jet: JetFrames) -> Figure:
    """Draw distributions of found bubbles in bins of depth above and below Y_p."""
    y, diameter = _positions(jet, jet.found)
    depths = np.arange(0.0, float(y.max(initial=0.0)) + DEPTH_MM, DEPTH_MM)
    sizes = np.arange(0.0, float(diameter.max(initial=0.0)) + _WIDE_BIN_MM, _WIDE_BIN_MM)
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
