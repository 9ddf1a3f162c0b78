"""Line drawings to scale, as SVG elements for a page."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, get_args

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.number_text import round_down

_Kind = Literal["sheet", "volume", "wall", "ray", "camera"]  # as they are painted
OUTLINE_KINDS: tuple[_Kind, ...] = get_args(_Kind)

# Okabe and Ito: colours that the colour-blind can distinguish
STYLE = """
.frame { fill: #ffffff; stroke: #999999; }
.camera { fill: #000000; stroke: #000000; }
.ray { fill: none; stroke: #0072B2; stroke-opacity: 0.35; }
.wall { fill: none; stroke: #56B4E9; stroke-width: 1.5; }
.sheet { fill: #009E73; fill-opacity: 0.25; stroke: none; }
.volume { fill: #E69F00; fill-opacity: 0.3; stroke: #D55E00; stroke-width: 1.5; }
.scale { fill: none; stroke: #000000; stroke-width: 2; }
text { font: 12px sans-serif; fill: #000000; }
"""

_LARGEST_PX = (560.0, 400.0)
_BELOW_PX = 24.0  # for the scale bar and the axes' names
_BAR = 0.25  # of the width: longest scale bar


@dataclass(frozen=True)
class Outline:
    """Line or polygon (n, 2) in mm as (horizontal, vertical), y downwards."""

    kind: _Kind
    points_mm: F64
    closed: bool = False


def draw_outlines(
    title: str, outlines: Sequence[Outline], low_mm: F64, high_mm: F64, axes: tuple[str, str]
) -> str:
    """Draw outlines in a window as an SVG element that uses the classes of `STYLE`.

    Parameters
    ----------
    low_mm, high_mm : (2,) corners of the window; what is outside is cut off.
    axes : names of the horizontal and of the vertical coordinate.
    """
    size = high_mm - low_mm
    scale = float((np.array(_LARGEST_PX) / size).min())
    width, height = size * scale
    shapes = []
    for outline in sorted(outlines, key=lambda outline: OUTLINE_KINDS.index(outline.kind)):
        points = (outline.points_mm - low_mm) * scale
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points if np.isfinite([x, y]).all())
        element = "polygon" if outline.closed else "polyline"
        shapes.append(f'<{element} class="{outline.kind}" points="{path}"/>')
    bar = round_down(_BAR * float(size[0]))
    below = height + _BELOW_PX - 8.0
    words = f"{bar:g} mm; {axes[0]} to the right, {axes[1]} down"
    parts = [
        f'<svg class="drawing" role="img" width="{width:.0f}" height="{height + _BELOW_PX:.0f}" '
        f'viewBox="0 0 {width:.1f} {height + _BELOW_PX:.1f}">',
        f"<title>{escape(title)}</title>",
        f'<svg width="{width:.1f}" height="{height:.1f}">',
        f'<rect class="frame" width="{width:.1f}" height="{height:.1f}"/>',
        *shapes,
        "</svg>",
        f'<path class="scale" d="M0 {below:.1f} h{bar * scale:.1f}"/>',
        f'<text x="{bar * scale + 6.0:.1f}" y="{below + 4.0:.1f}">{escape(words)}</text>',
        "</svg>",
    ]
    return "\n".join(parts)
