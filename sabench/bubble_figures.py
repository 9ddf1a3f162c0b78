"""Bubbles from the front and from the side, as figures 5-18 to 5-20 of the thesis show them."""

from __future__ import annotations

import numpy as np

from sabench.metrics.bubbles import AnyBubbles
from sabench.plots import Discs, Figure, Panel

_WIDE, _HIGH = 3.8, (2.6, 7.0)  # inches of a panel


def bubble_figure(bubbles: AnyBubbles, name: str, title: str = "") -> Figure:
    """Places and sizes across X-Y and Z-Y."""
    x, y, z = bubbles.center_mm.T
    views = (("front", "X, mm", x), ("side", "Z, mm", z))
    panels = [Panel(view, label, "Y, mm", (Discs("radius, mm", across, y, bubbles.radius_mm),)) for view, label, across in views]
    high = float(np.ptp(y) / max(np.ptp(x), np.ptp(z), 1e-9)) if len(y) else 1.0
    return Figure(name, title or f"{len(x)} bubbles", tuple(panels), inch=(_WIDE, float(np.clip(0.6 * _WIDE * high, *_HIGH))))
