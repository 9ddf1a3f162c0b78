"""Concentration, depth and tilt of plunging jets: figures 5-21 to 5-30."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sabench.evaluation.reproduction import Item
from sabench.evaluation.suite_loading import override
from sabench.metrics.bubble_detection import AnyBubbles
from sabench.metrics.plunging_jet import JetFigures, analyse, fit_total
from sabench.plotting.drawing import Cloud, Curve, Figure, Panel
from sabench.scenes import load_scene
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import EDGE, FALL, LN2, RISE

from . import jet_scaling
from .chapter_5 import FRAMES, NOZZLE_MM, JetFrames, detect_jet, detect_jets, jet_rows
from .common import claim, coarsen, make_row

_WEIGHT, _WIDTH = 0.903, 0.1894  # of figure 5-27
_SHOWN = 43  # mm: the height of figure 5-21
_COLLAPSED = (21, 43)  # mm: those of figure 5-30c
_EXPLAINED = 0.9  # of the mean square, where five points are enough

_NAMES = {"found": "found", "many": f"true, {FRAMES} frames"}

Analyses = dict[int, dict[str, JetFigures]]


def fig_5_21(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the scaling laws, and predict the concentration from five values.

    The scenes were built to equations 5.18, 5.19 and 5.22 and to the slopes of figure 5-30c, and
    bins of 20 by 8 mm blur them: compare found with true bubbles.
    """
    every: Analyses = {}
    for jet in detect_jets(seeds, pixels):
        every[jet.height] = jet.analyse()
        yield from _profiles(jet, every[jet.height])
    # fit equation 5.18 to all jets together: figure 5-27
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
    yield from _lines(every)
    for height, analyses in every.items():
        yield from _prediction(height, analyses)
    yield from _figures(every)


def _profiles(jet: JetFrames, analyses: dict[str, JetFigures]) -> Iterator[Item]:
    """Fit the radial law and the factor of equation 5.22 of one jet."""
    name = f"h = {jet.height} mm: "
    peaks = [100.0 * float(figures.concentration.max(initial=0.0)) for figures in analyses.values()]
    yield from jet_rows(
        f"{name}largest concentration, %", 8.0 if jet.height == _SHOWN else None, *peaks
    )
    for what, thesis, measure in (
        ("k of exp(-k (R / R_.5)^2) (5.19)", LN2, jet_scaling.radial_slope),
        ("C_Y / (C_max R_.5) (5.22)", jet_scaling.TOTAL, jet_scaling.total_factor),
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
            (jet.depth_mm - jet.depth_mm[jet.total.argmax()]) / jet.penetration_mm,
            jet.total / jet.total.max(),
        )
        for jet in (analyses[kind] for analyses in every.values())
        if _usable(jet)
    ]
    empty = [(np.zeros(0), np.zeros(0))]
    y, share = (np.concatenate(parts) for parts in zip(*(pairs or empty), strict=True))
    return y, share


def _lines(every: Analyses) -> Iterator[Item]:
    """Fit the slopes of figure 5-30c."""
    fits = []
    for kind in ("found", "true", "many"):
        jets = [every[height][kind] for height in _COLLAPSED if height in every]
        usable = [jet for jet in jets if _usable(jet)]
        fits.append(jet_scaling.slopes(usable) if usable else (np.nan, np.nan))
    for number, (name, thesis) in enumerate((("rising", RISE), ("falling", FALL))):
        yield from jet_rows(f"{name} slope of C* (5-30c)", thesis, *[fit[number] for fit in fits])


def _prediction(height: int, analyses: dict[str, JetFigures]) -> Iterator[Item]:
    """Predict C(Y, R) from five of its values; compare it with true bubbles."""
    name = f"h = {height} mm: share of C(Y, R) explained by five points"
    if not all(map(_usable, analyses.values())):
        yield claim(name, "five points are enough", None, False)
        return
    estimated, true, many = (jet_scaling.five_points(figures) for figures in analyses.values())
    share = jet_scaling.explained_share(many, analyses["many"])
    yield claim(
        f"{name}, true bubbles of {FRAMES} frames",
        "five points are enough",
        share,
        share >= _EXPLAINED,
        f"share of the mean square, {_EXPLAINED} asked for",
    )
    shares = [jet_scaling.explained_share(points, analyses["true"]) for points in (estimated, true)]
    yield from jet_rows(name, None, *shares)


def _figures(every: Analyses) -> Iterator[Item]:
    """Draw found bubbles, and true ones of `FRAMES` frames, over the laws."""
    usable = {key: kinds for key, kinds in every.items() if all(map(_usable, kinds.values()))}
    if _SHOWN in usable:
        yield _depth_and_radius(usable[_SHOWN]["found"])
    y = np.linspace(-0.7, 0.7, 29)
    gauss = _WEIGHT * np.exp(-(y**2) / (2.0 * _WIDTH**2)) + 1.0 - _WEIGHT
    both = {height: analyses for height, analyses in usable.items() if height in _COLLAPSED}
    lines = np.clip(1.0 + np.where(y < 0.0, RISE, FALL) * y, 0.0, 1.0)
    yield Figure(
        "fig-5-26",
        "total concentration",
        (
            _over(usable, "Y, mm", "C_Y, mm", lambda jet: (jet.depth_mm, jet.total)),
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
                (
                    *(
                        Cloud(_NAMES[kind], *jet_scaling.radial_points(analyses[kind]))
                        for kind in _NAMES
                    ),
                    law,
                ),
            )
            for height, analyses in usable.items()
        ),
    )
    yield Figure(
        "fig-5-30",
        "largest concentration over depth",
        (
            _over(usable, "Y, mm", "C_max", lambda jet: (jet.depth_mm, jet.largest)),
            _over(both, "Y*", "C*", jet_scaling.scaled_maximum, ("slopes 2.21, -2.87", y, lines)),
        ),
        inch=(5.6, 4.2),
    )


def _total(jet: JetFigures) -> tuple[F64, F64]:
    scaled = (jet.depth_mm - jet.depth_mm[jet.total.argmax()]) / jet.penetration_mm
    return scaled, jet.total / jet.total.max()


def _over(
    jets: Analyses,
    x: str,
    y: str,
    values: Callable[[JetFigures], tuple[F64, F64]],
    law: tuple[str, F64, F64] | None = None,
) -> Panel:
    curves = [
        Curve(f"{height} mm, {name}", *(list(part) for part in values(analyses[kind])))
        for height, analyses in jets.items()
        for kind, name in _NAMES.items()
    ]
    if law is not None:
        curves.append(Curve(law[0], list(law[1]), list(law[2])))
    return Panel("", x, y, tuple(curves))


def _depth_and_radius(jet: JetFigures) -> Figure:
    """Draw figure 5-21: C over depth, and over radius in the bin above the drop."""
    row = int(np.searchsorted(jet.depth_mm, jet.penetration_mm)) - 1
    profile = jet.concentration[row] / jet.concentration[row].max()
    edge = jet.equivalent_mm / 2.0
    return Figure(
        "fig-5-21",
        f"concentration, h = {_SHOWN} mm",
        (
            Panel(
                "",
                "Y, mm",
                "C_Y over its largest",
                (
                    Curve("found", list(jet.depth_mm), list(jet.total / jet.total.max())),
                    Curve("Y_p", [jet.penetration_mm] * 2, [0.0, 1.0]),
                ),
            ),
            Panel(
                f"Y = {jet.depth_mm[row]:.0f} mm",
                "R, mm",
                "C over its largest",
                (
                    Curve("found", list(jet.radius_mm), list(profile)),
                    Curve(f"{100.0 * EDGE:.0f} %: D_eq / 2", [edge] * 2, [0.0, 1.0]),
                ),
            ),
        ),
    )


def fig_5_22(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure Y_p / D over h / D with the diameters of impact and of the nozzle."""
    points: dict[str, list[tuple[float, float]]] = {}
    depths = []
    for jet in detect_jets(seeds, pixels):
        every = jet.analyse()
        depths.append(every["many"].penetration_mm)
        for name, diameter in (("D_i", jet.printed.diameter_mm), ("D_N", NOZZLE_MM)):
            ratios = [figures.penetration_mm / diameter for figures in every.values()]
            points.setdefault(name, []).append((jet.height / diameter, ratios[0]))
            yield from jet_rows(
                f"h / {name} = {jet.height / diameter:.2f}: Y_p / {name}",
                jet.printed.penetration_mm / diameter,
                *ratios,
            )
    finite = [depth for depth in depths if np.isfinite(depth)]
    yield claim(
        f"Y_p of the highest over that of the lowest nozzle, true bubbles of {FRAMES} frames",
        "a higher jet penetrates less",
        finite[-1] / finite[0] if finite else None,
        len(finite) == len(depths) and all(np.diff(finite) < 0.0),
    )
    clouds = tuple(
        Cloud(f"over {name}", *np.array(xy, dtype=np.float64).T) for name, xy in points.items()
    )
    panel = Panel("", "h / D", "Y_p / D", clouds, log="xy")
    yield Figure("fig-5-22", "penetration depth of found bubbles", (panel,))


_HEIGHT, _TILT_DEG = 21, 1.5  # the thesis saw this tilt; towards +X
_BINS = 3  # of depth above the penetration depth


def fig_5_28(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the tilt, and the cloud's figures before and after its removal."""
    scene = load_scene(f"plunging-jet-{_HEIGHT}")
    tilted = override(scene, {"bubbles.inclination_deg": [_TILT_DEG, 0.0]}, scene.title)
    jet = detect_jet(_HEIGHT, coarsen(tilted, pixels), seeds)
    try:
        estimated, true = (
            jet_scaling.find_tilt(_centers(every), jet.impact_mm) for every in (jet.found, jet.true)
        )
    except ValueError as error:  # too few bubbles in small images
        yield make_row("tilt towards X, degrees", _TILT_DEG, [], str(error))
        return
    for axis, thesis, tilt, true_tilt in zip("XZ", (_TILT_DEG, None), estimated, true, strict=True):
        note = f"the scene has {thesis or 0.0:g}; the axis of its true bubbles {true_tilt:.3f}"
        yield make_row(f"tilt towards {axis}, degrees", thesis, [tilt], note)
    turned = {"as found": (0.0, 0.0), "tilt removed": estimated}
    figures = {name: _analyse(jet, jet.found, tilt) for name, tilt in turned.items()}
    true_figures = _analyse(jet, jet.true, (_TILT_DEG, 0.0))
    for name, analysis in figures.items():
        for key, what in (("equivalent_mm", "D_eq, mm"), ("penetration_mm", "Y_p, mm")):
            yield from jet_rows(
                f"{name}: {what}", None, getattr(analysis, key), getattr(true_figures, key)
            )
    yield _figure(figures | {"true bubbles, true tilt": true_figures})


def _centers(every: Sequence[AnyBubbles]) -> F64:
    return np.concatenate([bubbles.center_mm for bubbles in every])


def _analyse(jet: JetFrames, every: Sequence[AnyBubbles], tilt: tuple[float, float]) -> JetFigures:
    volume = jet.scene.volume
    return analyse(
        jet_scaling.straighten(_centers(every), jet.impact_mm, tilt),
        np.concatenate([bubbles.radius_mm for bubbles in every]),
        jet.impact_mm,
        volume.center_mm[1] + volume.size_mm[1] / 2.0 - jet.impact_mm[1],
        EDGE,
        len(every),
    )


def _figure(figures: dict[str, JetFigures]) -> Figure:
    """Draw C over R at the depths above the penetration depth, before and after."""
    panels = []
    for name, analysis in figures.items():
        end = int(np.searchsorted(analysis.depth_mm, analysis.penetration_mm))
        curves = [
            Curve(f"Y = {analysis.depth_mm[row]:.0f} mm", list(analysis.radius_mm), list(part))
            for row, part in enumerate(analysis.concentration)
            if max(end - _BINS, 0) <= row < end
        ]
        panels.append(Panel(name, "R, mm", "C", tuple(curves)))
    return Figure("fig-5-28", f"jet tilted by {_TILT_DEG} degrees", tuple(panels))
