"""Figure 5-28: a jet's tilt of 1.5 degrees, found from bubbles and removed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.suite_loading import override
from sabench.evaluation.thesis.chapter_5 import JetFrames, detect_jet, jet_rows
from sabench.evaluation.thesis.common import Item, coarsen, make_row
from sabench.metrics.bubble_detection import AnyBubbles
from sabench.metrics.jet_tilt import find_tilt, straighten
from sabench.metrics.plunging_jet import JetFigures, analyse
from sabench.plotting.charts import Curve, Figure, Panel
from sabench.scenes import load_scene
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import EDGE

SEEDS = 5
_HEIGHT, _TILT_DEG = 21, 1.5  # the thesis saw this tilt; towards +X
_BINS = 3  # of depth above the penetration depth


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure the tilt, and the cloud's figures before and after its removal."""
    scene = load_scene(f"plunging-jet-{_HEIGHT}")
    tilted = override(scene, {"bubbles.inclination_deg": [_TILT_DEG, 0.0]}, scene.title)
    jet = detect_jet(_HEIGHT, coarsen(tilted, pixels), seeds)
    try:
        found, true = (find_tilt(_centers(every), jet.impact_mm) for every in (jet.found, jet.true))
    except ValueError as error:  # too few bubbles in small images
        yield make_row("tilt towards X, degrees", _TILT_DEG, [], str(error))
        return
    for axis, thesis, own, there in zip("XZ", (_TILT_DEG, None), found, true, strict=True):
        note = f"the scene has {thesis or 0.0:g}; the axis of its true bubbles {there:.3f}"
        yield make_row(f"tilt towards {axis}, degrees", thesis, [own], note)
    turned = {"as found": (0.0, 0.0), "tilt removed": found}
    figures = {name: _analyse(jet, jet.found, tilt) for name, tilt in turned.items()}
    true_figures = _analyse(jet, jet.true, (_TILT_DEG, 0.0))
    for name, one in figures.items():
        for key, what in (("equivalent_mm", "D_eq, mm"), ("penetration_mm", "Y_p, mm")):
            yield from jet_rows(
                f"{name}: {what}", None, getattr(one, key), getattr(true_figures, key)
            )
    yield _figure(figures | {"true bubbles, true tilt": true_figures})


def _centers(every: Sequence[AnyBubbles]) -> F64:
    return np.concatenate([one.center_mm for one in every])


def _analyse(jet: JetFrames, every: Sequence[AnyBubbles], tilt: tuple[float, float]) -> JetFigures:
    volume = jet.scene.volume
    return analyse(
        straighten(_centers(every), jet.impact_mm, tilt),
        np.concatenate([one.radius_mm for one in every]),
        jet.impact_mm,
        volume.center_mm[1] + volume.size_mm[1] / 2.0 - jet.impact_mm[1],
        EDGE,
        len(every),
    )


def _figure(figures: dict[str, JetFigures]) -> Figure:
    """Draw C over R at the depths above the penetration depth, before and after."""
    panels = []
    for name, one in figures.items():
        end = int(np.searchsorted(one.depth_mm, one.penetration_mm))
        curves = [
            Curve(f"Y = {one.depth_mm[row]:.0f} mm", list(one.radius_mm), list(part))
            for row, part in enumerate(one.concentration)
            if max(end - _BINS, 0) <= row < end
        ]
        panels.append(Panel(name, "R, mm", "C", tuple(curves)))
    return Figure("fig-5-28", f"jet tilted by {_TILT_DEG} degrees", tuple(panels))
