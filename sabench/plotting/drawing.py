"""Drawing of charts by Matplotlib, as PNG images."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.plotting.charts import (
    Circles,
    Cloud,
    Curve,
    Discs,
    Figure,
    Histogram,
    Panel,
    Picture,
    Slice,
    Space,
)

_DPI = 110
_BINS = 40
# Okabe and Ito: colours that the colour-blind can distinguish
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS = "os^Dv*x"
_FLAT = 2.0  # a slice so many times wider than high has its scale below it
_SMALL, _HANDLE_INCH, _LETTER_INCH = 7, 0.6, 0.06  # points of a legend's letters, its sizes
_ARROWS = 32  # along a slice's longer side at most


def draw(figure: Figure) -> bytes:
    """Draw a figure as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    # no gap in the last row where four fit
    across = figure.across or min(3 if len(figure.panels) % 4 else 4, len(figure.panels))
    down = -(-len(figure.panels) // across)
    sheet = Sheet(
        figsize=(across * figure.inch[0], down * figure.inch[1] + 0.4),
        dpi=_DPI,
        layout="constrained",
    )
    canvas: Any = FigureCanvasAgg(sheet)
    sheet.suptitle(figure.title, fontsize=11)
    places = []
    for number, panel in enumerate(figure.panels, 1):
        solid = isinstance(panel.content[0], Space)
        places.append(sheet.add_subplot(down, across, number, projection="3d" if solid else None))
        _fill(places[-1], panel)
    _add_legends(sheet, places, figure.panels)
    out = io.BytesIO()
    canvas.print_png(out, metadata={"Software": None})  # `savefig` would lay it out in a pass more
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
            _histogram(axes, one, edges, colour)
        elif isinstance(one, Cloud):
            _cloud(axes, one, colour)
        elif isinstance(one, Slice):
            _colour(axes, one)
        elif isinstance(one, Discs):
            _discs(axes, one)
        elif isinstance(one, Circles):
            _circles(axes, one, colour)
        elif isinstance(one, Picture):
            _picture(axes, one)
        elif isinstance(one, Space):
            _space(axes, one)
        else:
            _curve(axes, one, colour, marker)
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log:
        axes.set_yscale("log")


def _add_legends(sheet: Any, places: Sequence[Any], panels: Sequence[Panel]) -> None:
    """Add one legend below the figure where panels share all labels, or one to each."""
    handles, labels = places[0].get_legend_handles_labels()
    others = [axes.get_legend_handles_labels()[1] for axes in places[1:]]
    if others and len(labels) > 1 and all(own == labels for own in others):
        columns = int(sheet.get_figwidth() / (_HANDLE_INCH + _LETTER_INCH * max(map(len, labels))))
        sheet.legend(
            handles, labels, loc="outside lower center", ncols=max(columns, 1), fontsize=_SMALL
        )
        return
    for axes, panel in zip(places, panels, strict=True):
        if len(panel.content) > 1:
            axes.legend(fontsize=6)


def _curve(axes: Any, one: Curve, colour: str, marker: str) -> None:
    axes.errorbar(
        one.x,
        one.y,
        yerr=one.spread,
        color=colour,
        marker=marker,
        markersize=4,
        linewidth=1,
        capsize=2,
        label=one.label,
    )


def _histogram(axes: Any, one: Histogram, edges: npt.NDArray[np.float64], colour: str) -> None:
    axes.hist(
        one.values,
        bins=edges,
        density=True,
        histtype="step",
        linewidth=1.5,
        color=colour,
        label=one.label,
    )


def _cloud(axes: Any, one: Cloud, colour: str) -> None:
    axes.plot(
        one.x,
        one.y,
        linestyle="",
        marker=".",
        markersize=2,
        color=colour,
        label=one.label,
        rasterized=True,
    )


def _colour(axes: Any, one: Slice) -> None:
    top = float(np.nanmax(np.abs(one.values))) or 1.0
    colours, low = ("RdBu_r", -top) if one.signed else ("viridis", float(np.nanmin(one.values)))
    shown = axes.pcolormesh(
        one.x,
        one.y,
        one.values,
        cmap=colours,
        vmin=low,
        vmax=top if one.signed else None,
        shading="nearest",
        rasterized=True,
    )
    flat = abs(one.x[-1] - one.x[0]) > _FLAT * abs(one.y[-1] - one.y[0])
    axes.figure.colorbar(
        shown, ax=axes, orientation="horizontal" if flat else "vertical"
    ).set_label(one.label, fontsize=8)
    if one.arrows is not None:
        every = max(1, -(-max(one.values.shape) // _ARROWS))
        u, v = np.moveaxis(one.arrows[::every, ::every], -1, 0)
        x, y = np.meshgrid(one.x[::every], one.y[::every])
        known = np.isfinite(u) & np.isfinite(v)
        if known.any():
            axes.quiver(
                x[known], y[known], u[known], v[known], angles="xy", width=0.003, color="#000000"
            )
    axes.set_aspect("equal")
    axes.set_ylim(one.y[-1], one.y[0])
    axes.grid(visible=False)


def _discs(axes: Any, one: Discs) -> None:
    from matplotlib.collections import EllipseCollection

    order = np.argsort(-one.radius)  # small ones on top
    widths = 2.0 * one.radius[order]
    shown = EllipseCollection(
        widths,
        widths,
        np.zeros(len(widths)),
        units="xy",
        offsets=np.column_stack([one.x, one.y])[order],
        offset_transform=axes.transData,
        cmap="viridis",
        edgecolors="#00000066",
        linewidths=0.3,
    )
    shown.set_array(one.radius[order])
    axes.add_collection(shown)
    axes.figure.colorbar(shown, ax=axes).set_label(one.label, fontsize=8)
    axes.set_aspect("equal")
    if len(widths):
        margin = float(one.radius.max())
        axes.set_xlim(one.x.min() - margin, one.x.max() + margin)
        axes.set_ylim(one.y.max() + margin, one.y.min() - margin)
    axes.grid(visible=False)


def _circles(axes: Any, one: Circles, colour: str) -> None:
    from matplotlib.collections import EllipseCollection

    widths, positions = 2.0 * one.radius, np.column_stack([one.x, one.y])
    axes.add_collection(
        EllipseCollection(
            widths,
            widths,
            np.zeros(len(widths)),
            units="xy",
            offsets=positions,
            offset_transform=axes.transData,
            facecolors=f"{colour}55",
            edgecolors=colour,
            linewidths=0.8,
        )
    )
    # what the legend shows
    axes.plot(
        [],
        [],
        linestyle="",
        marker="o",
        markersize=5,
        color=colour,
        label=f"{one.label}: {len(widths)}",
    )
    if len(widths):
        axes.update_datalim(
            np.concatenate([positions - one.radius[:, None], positions + one.radius[:, None]])
        )
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.yaxis.set_inverted(True)


def _picture(axes: Any, one: Picture) -> None:
    from matplotlib.collections import EllipseCollection

    rows, columns = one.values.shape
    half = [
        (end - start) / max(count - 1, 1) / 2.0
        for start, end, count in zip(one.low, one.high, (columns, rows), strict=True)
    ]
    extent = (
        one.low[0] - half[0],
        one.high[0] + half[0],
        one.high[1] + half[1],
        one.low[1] - half[1],
    )
    dark, bright = np.percentile(one.values, [0.0, 99.9])
    axes.imshow(
        one.values,
        cmap="gray",
        vmin=dark,
        vmax=max(bright, dark + 1e-12),
        extent=extent,
        interpolation="nearest",
    )
    if one.rings is not None:
        widths = 2.0 * one.rings[:, 2]
        axes.add_collection(
            EllipseCollection(
                widths,
                widths,
                np.zeros(len(widths)),
                units="xy",
                offsets=one.rings[:, :2],
                offset_transform=axes.transData,
                facecolors="none",
                edgecolors=_COLOURS[1],
                linewidths=0.7,
            )
        )
        axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.grid(visible=False)


def _space(axes: Any, one: Space) -> None:
    """Draw balls as discs, whose areas are in points squared.

    The longest edge of the box is about half as long as the panel is high.
    """
    from matplotlib.ticker import MaxNLocator

    x, y, z = one.center.T
    spans = np.maximum(np.ptp(one.center, axis=0), 1e-9) if len(one.center) else np.ones(3)
    points = 2.0 * one.radius / spans.max() * 0.5 * 72.0 * axes.figure.get_figheight()
    shown = axes.scatter(
        x,
        z,
        y,
        s=points**2,
        c=one.radius,
        cmap="viridis",
        depthshade=False,
        edgecolors="#00000066",
        linewidths=0.3,
    )
    axes.figure.colorbar(shown, ax=axes, shrink=0.5).set_label(one.label, fontsize=8)
    axes.set_box_aspect(spans[[0, 2, 1]], zoom=1.3)
    axes.invert_zaxis()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(3))
    axes.set_ylabel("Z, mm", fontsize=8)
    axes.set_zlabel("Y, mm", fontsize=8)


def _edges(values: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Compute common bins of all histograms of a panel.

    The outermost thousandth on either side is left out.
    """
    if not values:
        return np.zeros(0)
    every = np.concatenate(values)
    low, high = np.quantile(every[np.isfinite(every)], [0.001, 0.999])
    return np.linspace(low, high, _BINS + 1)
