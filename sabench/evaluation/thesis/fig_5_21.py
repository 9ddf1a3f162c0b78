"""Figures 5-21 and 5-26 to 5-30: concentration over depth and radius.

It is that of detected bubbles.

The scenes were built to equations 5.18, 5.19 and 5.22 and to the slopes of figure 5-30c, and bins
of 20 by 8 mm blur them: compare found with true bubbles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_5 import FRAMES, JetFrames, detect_jets, jet_rows
from sabench.evaluation.thesis.common import Item, claim
from sabench.metrics.jet_scaling import (
    TOTAL,
    explained_share,
    five_points,
    radial_points,
    radial_slope,
    scaled_maximum,
    slopes,
    total_factor,
)
from sabench.metrics.plunging_jet import JetFigures, fit_total
from sabench.plotting.charts import Cloud, Curve, Figure, Panel
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import EDGE, FALL, LN2, RISE

SEEDS = 10
_WEIGHT, _WIDTH = 0.903, 0.1894  # of figure 5-27
_SHOWN = 43  # mm: the height of figure 5-21
_COLLAPSED = (21, 43)  # mm: those of figure 5-30c
_EXPLAINED = 0.9  # of the mean square, where five points are enough

_NAMES = {"found": "found", "many": f"true, {FRAMES} frames"}

Analyses = dict[int, dict[str, JetFigures]]


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scaling laws, and predict the concentration from five values."""
    every: Analyses = {}
    for jet in detect_jets(seeds, pixels):
        every[jet.height] = jet.analyse()
        yield from _profiles(jet, every[jet.height])
    yield from _gauss(every)
    yield from _lines(every)
    for height, analyses in every.items():
        yield from _prediction(height, analyses)
    yield from _figures(every)


def _profiles(jet: JetFrames, analyses: dict[str, JetFigures]) -> Iterator[Item]:
    """Fit the radial law and the factor of equation 5.22 of one jet."""
    name = f"h = {jet.height} mm: "
    own = [100.0 * float(figures.concentration.max(initial=0.0)) for figures in analyses.values()]
    yield from jet_rows(
        f"{name}largest concentration, %", 8.0 if jet.height == _SHOWN else None, *own
    )
    for what, thesis, measure in (
        ("k of exp(-k (R / R_.5)^2) (5.19)", LN2, radial_slope),
        ("C_Y / (C_max R_.5) (5.22)", TOTAL, total_factor),
    ):
        yield from jet_rows(
            f"{name}{what}", thesis, *[measure(figures) for figures in analyses.values()]
        )


def _usable(figures: JetFigures) -> bool:
    return bool(np.isfinite(figures.penetration_mm))


def _pooled(every: Analyses, kind: str) -> tuple[F64, F64]:
    """Scale C_Y of all jets: Y* and C_Y over its maximum (n,).

    Jets without a penetration depth are left out.
    """
    pairs = [
        (
            (one.depth_mm - one.depth_mm[one.total.argmax()]) / one.penetration_mm,
            one.total / one.total.max(),
        )
        for one in (analyses[kind] for analyses in every.values())
        if _usable(one)
    ]
    empty = [(np.zeros(0), np.zeros(0))]
    y, share = (np.concatenate(parts) for parts in zip(*(pairs or empty), strict=True))
    return y, share


def _gauss(every: Analyses) -> Iterator[Item]:
    """Fit equation 5.18 to all jets together: figure 5-27."""
    fits, rest = [], []
    for kind in ("found", "true", "many"):
        y, share = _pooled(every, kind)
        weight, width = fit_total(y, share) if len(y) > 3 else (np.nan, np.nan)
        law = weight * np.exp(-(y**2) / (2.0 * width**2)) + 1.0 - weight
        fits.append((weight, width))
        rest.append(float(np.sqrt(np.mean((share - law) ** 2))) if len(y) > 3 else np.nan)
    for number, (name, thesis) in enumerate((("A", _WEIGHT), ("s", _WIDTH))):
        yield from jet_rows(
            f"all jets: {name} of equation 5.18", thesis, *[fit[number] for fit in fits]
        )
    yield from jet_rows("all jets: rms distance from equation 5.18", None, *rest)


def _lines(every: Analyses) -> Iterator[Item]:
    """Fit the slopes of figure 5-30c."""
    fits = []
    for kind in ("found", "true", "many"):
        jets = [every[height][kind] for height in _COLLAPSED if height in every]
        usable = [jet for jet in jets if _usable(jet)]
        fits.append(slopes(usable) if usable else (np.nan, np.nan))
    for number, (name, thesis) in enumerate((("rising", RISE), ("falling", FALL))):
        yield from jet_rows(f"{name} slope of C* (5-30c)", thesis, *[fit[number] for fit in fits])


def _prediction(height: int, analyses: dict[str, JetFigures]) -> Iterator[Item]:
    """Predict C(Y, R) from five of its values; compare it with true bubbles."""
    name = f"h = {height} mm: share of C(Y, R) explained by five points"
    if not all(map(_usable, analyses.values())):
        yield claim(name, "five points are enough", None, False)
        return
    found, true, many = (five_points(figures) for figures in analyses.values())
    share = explained_share(many, analyses["many"])
    yield claim(
        f"{name}, true bubbles of {FRAMES} frames",
        "five points are enough",
        share,
        share >= _EXPLAINED,
        f"share of the mean square, {_EXPLAINED} asked for",
    )
    own = [explained_share(points, analyses["true"]) for points in (found, true)]
    yield from jet_rows(name, None, *own)


def _figures(every: Analyses) -> Iterator[Item]:
    """Draw found bubbles, and true ones of `FRAMES` frames, over the laws."""
    usable = {key: one for key, one in every.items() if all(map(_usable, one.values()))}
    if _SHOWN in usable:
        yield _depth_and_radius(usable[_SHOWN]["found"])
    y = np.linspace(-0.7, 0.7, 29)
    gauss = _WEIGHT * np.exp(-(y**2) / (2.0 * _WIDTH**2)) + 1.0 - _WEIGHT
    both = {height: one for height, one in usable.items() if height in _COLLAPSED}
    lines = np.clip(1.0 + np.where(y < 0.0, RISE, FALL) * y, 0.0, 1.0)
    yield Figure(
        "fig-5-26",
        "total concentration",
        (
            _over(usable, "Y, mm", "C_Y, mm", lambda one: (one.depth_mm, one.total)),
            _over(usable, "Y*", "C_Y over its largest", _total, ("equation 5.18", y, gauss)),
        ),
        inch=(5.6, 4.2),
    )
    r = np.linspace(0.0, 4.0, 30)
    law = Curve("equation 5.19", list(r), list(np.exp(-LN2 * r**2)))
    yield Figure(
        "fig-5-29",
        "concentration over radius",
        tuple(
            Panel(
                f"h = {height} mm",
                "R / R_.5",
                "C / C_max",
                (*(Cloud(_NAMES[kind], *radial_points(one[kind])) for kind in _NAMES), law),
            )
            for height, one in usable.items()
        ),
    )
    yield Figure(
        "fig-5-30",
        "largest concentration over depth",
        (
            _over(usable, "Y, mm", "C_max", lambda one: (one.depth_mm, one.largest)),
            _over(both, "Y*", "C*", scaled_maximum, ("slopes 2.21, -2.87", y, lines)),
        ),
        inch=(5.6, 4.2),
    )


def _total(one: JetFigures) -> tuple[F64, F64]:
    scaled = (one.depth_mm - one.depth_mm[one.total.argmax()]) / one.penetration_mm
    return scaled, one.total / one.total.max()


def _over(
    jets: Analyses,
    x: str,
    y: str,
    values: Callable[[JetFigures], tuple[F64, F64]],
    law: tuple[str, F64, F64] | None = None,
) -> Panel:
    curves = [
        Curve(f"{height} mm, {name}", *(list(part) for part in values(one[kind])))
        for height, one in jets.items()
        for kind, name in _NAMES.items()
    ]
    if law is not None:
        curves.append(Curve(law[0], list(law[1]), list(law[2])))
    return Panel("", x, y, tuple(curves))


def _depth_and_radius(one: JetFigures) -> Figure:
    """Draw figure 5-21: C over depth, and over radius in the bin above the drop."""
    row = int(np.searchsorted(one.depth_mm, one.penetration_mm)) - 1
    profile = one.concentration[row] / one.concentration[row].max()
    edge = one.equivalent_mm / 2.0
    return Figure(
        "fig-5-21",
        f"concentration, h = {_SHOWN} mm",
        (
            Panel(
                "",
                "Y, mm",
                "C_Y over its largest",
                (
                    Curve("found", list(one.depth_mm), list(one.total / one.total.max())),
                    Curve("Y_p", [one.penetration_mm] * 2, [0.0, 1.0]),
                ),
            ),
            Panel(
                f"Y = {one.depth_mm[row]:.0f} mm",
                "R, mm",
                "C over its largest",
                (
                    Curve("found", list(one.radius_mm), list(profile)),
                    Curve(f"{100.0 * EDGE:.0f} %: D_eq / 2", [edge] * 2, [0.0, 1.0]),
                ),
            ),
        ),
    )
