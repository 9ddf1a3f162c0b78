"""Charts as values, and their drawing by Matplotlib as PNG images."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.plotting.kinds import COLOURS

_PANEL_INCH = (4.2, 3.2)


@dataclass(frozen=True)
class Curve:
    """Values (n,) over others, with half widths of their spread where given."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    spread: Sequence[float] | None = None


@dataclass(frozen=True)
class Histogram:
    """Distribution of values."""

    label: str
    values: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Cloud:
    """Points (n,) without lines."""

    label: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Slice:
    """Values (rows, columns) on a lattice in colours; alone in its panel.

    y points downwards, as in images.

    Attributes
    ----------
    x, y : coordinates of the columns and of the rows.
    signed : whether zero is the middle of the colours.
    arrows : (rows, columns, 2) vectors over them, if there are any; NaN for none.
    """

    label: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]
    signed: bool = False
    arrows: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Circles:
    """Circles (n,) in the colour of a kind, their label; kinds may share a panel.

    Radii are in the unit of the axes; y points downwards.
    """

    label: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    radius: npt.NDArray[np.float64]


class Discs(Circles):
    """Circles (n,) coloured by their radii; alone in their panel."""


@dataclass(frozen=True)
class Picture:
    """Grey image (rows, columns), from its least to its largest value.

    It comes first in its panel, under clouds and curves; y points downwards.

    Attributes
    ----------
    low, high : coordinates (x, y) of the centres of its first and last pixel.
    rings : (n, 3) circles over it: centres and radii, in the unit of the axes.
    """

    values: npt.NDArray[np.float64]
    low: tuple[float, float]
    high: tuple[float, float]
    rings: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Space:
    """Balls (n,) in space as discs coloured by size, y downwards; alone in its panel."""

    label: str
    center: npt.NDArray[np.float64]
    radius: npt.NDArray[np.float64]


Content = Curve | Histogram | Cloud | Slice | Discs | Circles | Picture | Space


@dataclass(frozen=True)
class Panel:
    """Pair of axes; `log` names the logarithmic ones: "", "x", "y" or "xy"."""

    title: str
    x: str
    y: str
    content: tuple[Content, ...]
    log: str = ""


@dataclass(frozen=True)
class Figure:
    """Figure of several panels.

    Attributes
    ----------
    name : name of the file.
    across : panels in a row.
    inch : width and height of a panel.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    across: int | None = None
    inch: tuple[float, float] = _PANEL_INCH


_DPI = 110
_BINS = 40
# Okabe and Ito: colours that the colour-blind can distinguish
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_MARKERS = "os^Dv*x"
_SMALL, _HANDLE_INCH, _LETTER_INCH = 7, 0.6, 0.06  # points of a legend's letters, its sizes
_ARROWS = 32  # along a slice's longer side at most


def draw(figure: Figure) -> bytes:
    """Draw a figure as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Sheet

    # no gap in the last row where four fit
    across = figure.across or min(3 if len(figure.panels) % 4 else 4, len(figure.panels))
    down = -(-len(figure.panels) // across)
    inches = (across * figure.inch[0], down * figure.inch[1] + 0.4)
    sheet = Sheet(figsize=inches, dpi=_DPI, layout="constrained")
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


def draw_panel(x: str, y: str, *content: Content) -> bytes:
    """Draw one panel without a title as a PNG."""
    return draw(Figure("", "", (Panel("", x, y, content),)))


def draw_balls(
    center_mm: npt.NDArray[np.float64], radius_mm: npt.NDArray[np.float64] | None = None
) -> bytes:
    """Draw balls or, without radii (n,), points (n, 3) as seen along Z, as a PNG."""
    x, y, _ = center_mm.T
    dot = 0.003 * float(np.ptp(center_mm[:, :2]))
    radius = np.full(len(x), dot) if radius_mm is None else radius_mm
    return draw_panel("X, mm", "Y, mm", Circles("", x, y, radius))


def _fill(axes: Any, panel: Panel) -> None:
    axes.set_title(panel.title, fontsize=9)
    axes.set_xlabel(panel.x, fontsize=8)
    axes.set_ylabel(panel.y, fontsize=8)
    axes.tick_params(which="both", labelsize=7)
    axes.grid(alpha=0.3)
    edges = _edges([item.values for item in panel.content if isinstance(item, Histogram)])
    for number, item in enumerate(panel.content):
        colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
        if isinstance(item, Histogram):
            style = {"histtype": "step", "linewidth": 1.5, "color": colour, "label": item.label}
            axes.hist(item.values, bins=edges, density=True, **style)
        elif isinstance(item, Cloud):
            style = {"linestyle": "", "marker": ".", "markersize": 2, "rasterized": True}
            axes.plot(item.x, item.y, color=colour, label=item.label, **style)
        elif isinstance(item, Slice):
            _slice(axes, item)
        elif isinstance(item, Discs):
            _discs(axes, item)
        elif isinstance(item, Circles):
            _circles(axes, item)
        elif isinstance(item, Picture):
            _picture(axes, item)
        elif isinstance(item, Space):
            _space(axes, item)
        else:
            style = {"color": colour, "marker": marker, "markersize": 4, "linewidth": 1}
            bars = {"yerr": item.spread, "capsize": 2}
            axes.errorbar(item.x, item.y, label=item.label, **bars, **style)
    if "x" in panel.log:
        axes.set_xscale("log")
    if "y" in panel.log:
        axes.set_yscale("log")


def _add_legends(sheet: Any, places: Sequence[Any], panels: Sequence[Panel]) -> None:
    """Add one legend below the figure where panels share all labels, or one to each."""
    handles, labels = places[0].get_legend_handles_labels()
    others = [axes.get_legend_handles_labels()[1] for axes in places[1:]]
    if others and len(labels) > 1 and all(names == labels for names in others):
        columns = int(sheet.get_figwidth() / (_HANDLE_INCH + _LETTER_INCH * max(map(len, labels))))
        place = {"loc": "outside lower center", "ncols": max(columns, 1)}
        sheet.legend(handles, labels, fontsize=_SMALL, **place)
        return
    for axes, panel in zip(places, panels, strict=True):
        if len(panel.content) > 1:
            axes.legend(fontsize=6)


def _add_ellipses(
    axes: Any, centers: npt.NDArray[np.float64], widths: npt.NDArray[np.float64], **style: Any
) -> Any:
    """Add circles (n,) at centres (n, 2), in the unit of the axes."""
    from matplotlib.collections import EllipseCollection

    place = {"units": "xy", "offsets": centers, "offset_transform": axes.transData}
    shown = EllipseCollection(widths, widths, np.zeros(len(widths)), **place, **style)
    axes.add_collection(shown)
    return shown


def _slice(axes: Any, cut: Slice) -> None:
    top = float(np.nanmax(np.abs(cut.values))) or 1.0
    colours, low = ("RdBu_r", -top) if cut.signed else ("viridis", float(np.nanmin(cut.values)))
    scale = {"cmap": colours, "vmin": low, "vmax": top if cut.signed else None}
    shown = axes.pcolormesh(cut.x, cut.y, cut.values, shading="nearest", rasterized=True, **scale)
    wide = abs(cut.x[-1] - cut.x[0]) > abs(cut.y[-1] - cut.y[0])
    bar = axes.figure.colorbar(shown, ax=axes, orientation="horizontal" if wide else "vertical")
    bar.set_label(cut.label, fontsize=8)
    if cut.arrows is not None:
        every = max(1, -(-max(cut.values.shape) // _ARROWS))
        u, v = np.moveaxis(cut.arrows[::every, ::every], -1, 0)
        x, y = np.meshgrid(cut.x[::every], cut.y[::every])
        finite = np.isfinite(u) & np.isfinite(v)
        if finite.any():
            vectors = (values[finite] for values in (x, y, u, v))
            axes.quiver(*vectors, angles="xy", width=0.003, color="#000000")
    axes.set_aspect("equal")
    axes.set_ylim(cut.y[-1], cut.y[0])
    axes.grid(visible=False)


def _discs(axes: Any, discs: Discs) -> None:
    order = np.argsort(-discs.radius)  # small ones on top
    widths, centers = 2.0 * discs.radius[order], np.column_stack([discs.x, discs.y])[order]
    style = {"cmap": "viridis", "edgecolors": "#00000066", "linewidths": 0.3}
    shown = _add_ellipses(axes, centers, widths, array=discs.radius[order], **style)
    axes.figure.colorbar(shown, ax=axes).set_label(discs.label, fontsize=8)
    axes.set_aspect("equal")
    if len(widths):
        margin = float(discs.radius.max())
        axes.set_xlim(discs.x.min() - margin, discs.x.max() + margin)
        axes.set_ylim(discs.y.max() + margin, discs.y.min() - margin)
    axes.grid(visible=False)


def _circles(axes: Any, circles: Circles) -> None:
    widths, positions = 2.0 * circles.radius, np.column_stack([circles.x, circles.y])
    colour = COLOURS.get(circles.label, "#57606a")  # grey: of no kind
    style = {"facecolors": f"{colour}55", "edgecolors": colour, "linewidths": 0.8}
    _add_ellipses(axes, positions, widths, **style)
    # the legend's entry
    handle = {"linestyle": "", "marker": "o", "markersize": 5, "color": colour}
    axes.plot([], [], label=f"{circles.label}: {len(widths)}", **handle)
    if len(widths):
        reach = circles.radius[:, None]
        axes.update_datalim(np.concatenate([positions - reach, positions + reach]))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.yaxis.set_inverted(True)


def _picture(axes: Any, picture: Picture) -> None:
    rows, columns = picture.values.shape
    (left, top), (right, bottom) = picture.low, picture.high
    half_x = (right - left) / max(columns - 1, 1) / 2.0
    half_y = (bottom - top) / max(rows - 1, 1) / 2.0
    extent = (left - half_x, right + half_x, bottom + half_y, top - half_y)
    dark, bright = np.percentile(picture.values, [0.0, 99.9])
    scale = {"cmap": "gray", "vmin": dark, "vmax": max(bright, dark + 1e-12)}
    axes.imshow(picture.values, extent=extent, interpolation="nearest", **scale)
    if picture.rings is not None:
        style = {"facecolors": "none", "edgecolors": _COLOURS[1], "linewidths": 0.7}
        _add_ellipses(axes, picture.rings[:, :2], 2.0 * picture.rings[:, 2], **style)
        axes.set(xlim=extent[:2], ylim=extent[2:])
    axes.grid(visible=False)


def _space(axes: Any, space: Space) -> None:
    """Draw balls as discs, with areas in points squared.

    The longest edge of the box is about half as long as the panel is high.
    """
    from matplotlib.ticker import MaxNLocator

    x, y, z = space.center.T
    spans = np.maximum(np.ptp(space.center, axis=0), 1e-9) if len(space.center) else np.ones(3)
    points = 2.0 * space.radius / spans.max() * 0.5 * 72.0 * axes.figure.get_figheight()
    style = {"cmap": "viridis", "edgecolors": "#00000066", "linewidths": 0.3}
    shown = axes.scatter(x, z, y, s=points**2, c=space.radius, depthshade=False, **style)
    axes.figure.colorbar(shown, ax=axes, shrink=0.5).set_label(space.label, fontsize=8)
    axes.set_box_aspect(spans[[0, 2, 1]], zoom=1.3)
    axes.invert_zaxis()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(3))
    axes.set_ylabel("Z, mm", fontsize=8)
    axes.set_zlabel("Y, mm", fontsize=8)


def _edges(values: Sequence[npt.NDArray[np.float64]]) -> npt.NDArray[np.float64]:
    """Compute a panel's common bins, without the outermost thousandth on either side."""
    if not values:
        return np.zeros(0)
    every = np.concatenate(values)
    low, high = np.quantile(every[np.isfinite(every)], [0.001, 0.999])
    return np.linspace(low, high, _BINS + 1)
