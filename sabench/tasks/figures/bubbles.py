"""Figures of bubbles from the front and from the side.

They follow figures 5-18 to 5-20 of the thesis.
"""

from __future__ import annotations

import numpy as np

from sabench.metrics.bubble_detection import AnyBubbles, match
from sabench.plotting.charts import Circles, Discs, Figure, Panel
from sabench.utils.arrays import F64

_WIDE, _HIGH = 3.8, (2.6, 7.0)  # inches of a panel


def bubble_figure(bubbles: AnyBubbles, name: str, title: str = "") -> Figure:
    """Draw positions and sizes across X-Y and Z-Y."""
    x, y, z = bubbles.center_mm.T
    views = (("front", "X, mm", x), ("side", "Z, mm", z))
    panels = [
        Panel(view, label, "Y, mm", (Discs("radius, mm", across, y, bubbles.radius_mm),))
        for view, label, across in views
    ]
    return Figure(name, title or f"{len(x)} bubbles", tuple(panels), inch=_inch(bubbles.center_mm))


def _inch(center_mm: F64) -> tuple[float, float]:
    """Compute the width and height of a panel that shows these positions."""
    x, y, z = np.ptp(center_mm, axis=0) if len(center_mm) else np.ones(3)
    return _WIDE, float(np.clip(0.6 * _WIDE * y / max(x, z, 1e-9), *_HIGH))


def detection_figure(found: AnyBubbles, true: AnyBubbles) -> Figure:
    """Draw the found, missed and false bubbles across X-Y and Z-Y."""
    i, j = match(found.center_mm, true.center_mm, true.radius_mm)
    ghosts, missed = (
        np.setdiff1d(np.arange(len(one.radius_mm)), hit) for one, hit in ((found, i), (true, j))
    )
    kinds = (("missed", true, missed), ("not there", found, ghosts), ("found", true, j))
    panels = tuple(
        Panel(
            view,
            label,
            "Y, mm",
            tuple(
                Circles(
                    kind, one.center_mm[which, axis], one.center_mm[which, 1], one.radius_mm[which]
                )
                for kind, one, which in kinds
            ),
        )
        for view, label, axis in (("front", "X, mm", 0), ("side", "Z, mm", 2))
    )
    title = f"{len(j)} found, {len(missed)} missed, {len(ghosts)} not there"
    return Figure(
        "errors", title, panels, inch=_inch(np.concatenate([true.center_mm, found.center_mm]))
    )
