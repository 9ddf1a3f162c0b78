"""Table 5.2 and figures 5-18 to 5-20: three plunging jets from detected bubbles.

All values are those of bubbles detected in rendered frames. The scenes were built to the thesis's
values, which are measurements of its own jets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_5 import (
    JETS,
    SOLVER,
    JetFrames,
    detect_jets,
    jet_rows,
)
from sabench.evaluation.thesis.common import Item, make_row
from sabench.metrics.bubble_detection import detection_scores
from sabench.plotting.charts import Figure, Panel, Space

SEEDS = 10
_FIGURES = dict(zip(JETS, ("5-18", "5-19", "5-20"), strict=True))
_LARGE = {
    "f1_large": "F1 of bubbles of 0.5 mm radius and more",
    "radius_percent": "radius error, %",
    "depth_mm": "depth error, mm",
}
_WEIGHT, _WIDTH = 0.903, 0.1894  # of equation 5.18


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Measure errors of the bubbles, and the jet's figures, per jet.

    Errors are means over frames. Figures are from all frames together, of detected bubbles; notes
    give those of true ones.
    """
    for jet in detect_jets(seeds, pixels):
        yield _figure(jet)
        yield from _errors(jet)
        yield from _table(jet)


def _errors(jet: JetFrames) -> Iterator[Item]:
    scores = [
        detection_scores(found, true, np.ones(len(true.center_mm)))
        for found, true in zip(jet.found, jet.true, strict=True)
    ]
    for key, name in _LARGE.items():
        values = [one[key] for one in scores if np.isfinite(one[key])]
        yield make_row(f"h = {jet.height} mm, {SOLVER}: {name}", None, values)


def _table(jet: JetFrames) -> Iterator[Item]:
    every, printed = jet.analyse(), jet.printed
    for key, name, thesis in (
        ("cone_percent", "C_tot, %", printed.total_percent),
        ("penetration_mm", "Y_p, mm", printed.penetration_mm),
        ("equivalent_mm", "D_eq, mm", printed.equivalent_mm),
        ("angle_deg", "angle, degrees", printed.angle_deg),
        ("weight", "A of equation 5.18", _WEIGHT),
        ("width", "s of equation 5.18", _WIDTH),
    ):
        own = [float(getattr(figures, key)) for figures in every.values()]
        yield from jet_rows(f"h = {jet.height} mm: {name}", thesis, *own)


def _figure(jet: JetFrames) -> Figure:
    """Draw the true and the found bubbles of the first frame in space."""
    panels = tuple(
        Panel(title, "X, mm", "", (Space("radius, mm", one.center_mm, one.radius_mm),))
        for title, one in (("true", jet.true[0]), ("found", jet.found[0]))
    )
    number = _FIGURES[jet.height]
    return Figure(f"fig-{number}", f"bubbles, h = {jet.height} mm", panels, inch=(4.6, 6.4))
