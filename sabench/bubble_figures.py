"""Bubbles from the front and from the side, as figures 5-18 to 5-20 of the thesis show them."""

from __future__ import annotations

from sabench.metrics.bubbles import AnyBubbles
from sabench.plots import Discs, Figure, Panel


def bubble_figure(bubbles: AnyBubbles, name: str, title: str = "") -> Figure:
    """Places and sizes across X-Y and Z-Y."""
    x, y, z = bubbles.center_mm.T
    views = (("front", "X, mm", x), ("side", "Z, mm", z))
    panels = [Panel(view, label, "Y, mm", (Discs("radius, mm", across, y, bubbles.radius_mm),)) for view, label, across in views]
    return Figure(name, title or f"{len(x)} bubbles", tuple(panels))
