"""Charts as values: figures of panels of curves, histograms, slices."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
class Discs:
    """Circles (n,) coloured by their radii; alone in their panel.

    Radii are in the unit of the axes; y points downwards.
    """

    label: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    radius: npt.NDArray[np.float64]


@dataclass(frozen=True)
class Circles:
    """Circles (n,) of one colour; several kinds may share a panel.

    Radii are in the unit of the axes; y points downwards.
    """

    label: str
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    radius: npt.NDArray[np.float64]


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
    """Balls (n,) in space as discs coloured by their size; alone in its panel.

    y points downwards.
    """

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
