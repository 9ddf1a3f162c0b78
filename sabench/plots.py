"""Figures of tables: curves and histograms as PNG pictures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

_PANEL_INCH, _DPI = (4.2, 3.2), 110
_BINS = 40
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # Okabe and Ito: told apart by the colour-blind
_MARKERS = "os^Dv*x"


@dataclass(frozen=True)
class Curve:
    """Values (n,) over others, with half widths of their spread if there is one."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    spread: Sequence[float] | None = None


@dataclass(frozen=True)
class Histogram:
    """The distribution of values."""

    label: str
    values: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `log` names those that are logarithmic: "", "x", "y" or "xy"."""

    title: str
    x: str
    y: str
    content: tuple[Curve | Histogram, ...]
    log: str = ""


@dataclass(frozen=True)
class Figure:
    """Panels beside each other; `name` becomes the file's."""

    name: str
    title: str
    panels: tuple[Panel, ...]


def draw(figure: Figure) -> bytes:
    """A figure as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    across = min(3 if len(figure.panels) % 4 else 4, len(figure.panels))  # no gap in the last row where four fit
    down = -(-len(figure.panels) // across)
    sheet = Sheet(figsize=(across * _PANEL_INCH[0], down * _PANEL_INCH[1] + 0.4), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(sheet)
    sheet.suptitle(figure.title, fontsize=11)
    for number, panel in enumerate(figure.panels, 1):
        _fill(sheet.add_subplot(down, across, number), panel)
    out = io.BytesIO()
    sheet.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _fill(axes: Any, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(panel.x, fontsize=8)
    axes.set_ylabel(panel.y, fontsize=8)
    axes.tick_params(which="both", labelsize=7)
    axes.grid(alpha=0.3)
    edges = _edges([one.values for one in panel.content if isinstance(one, Histogram)])
    for number, one in enumerate(panel.content):
        colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
        if isinstance(one, Histogram):
            axes.hist(one.values, bins=edges, density=True, histtype="step", linewidth=1.5, color=colour, label=one.label)
        else:
            axes.errorbar(one.x, one.y, yerr=one.spread, color=colour, marker=marker, markersize=4, linewidth=1, capsize=2, label=one.label)
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log:
        axes.set_yscale("log")
    if len(panel.content) > 1:
        axes.legend(fontsize=6)


def _edges(values: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Common bins of all histograms of a panel, without the outermost thousandth on either side."""
    if not values:
        return np.zeros(0)
    every = np.concatenate(values)
    low, high = np.quantile(every[np.isfinite(every)], [0.001, 0.999])
    return np.linspace(low, high, _BINS + 1)
