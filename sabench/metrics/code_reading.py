"""How well a code of dark and bright cells is seen: contrast, separation, and the part of it that is read."""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64, Bool


def reading(cells: F64, dark: Bool) -> dict[str, float]:
    """Figures of one picture of a code.

    Parameters
    ----------
    cells : (cell,) mean brightness of each; NaN where the picture does not show it: such a cell is
        not read.
    dark : (cell,) which are dark.

    Returns
    -------
    read_percent : cells on the right side of Otsu's threshold (IEEE Trans. Syst. Man Cybern. 9, 62,
        1979); guessing gives 50.
    contrast : Michelson's, of the mean bright and the mean dark cell.
    separation : difference of these means over the root mean square of the two standard deviations
        (d').
    """
    shown = np.isfinite(cells)
    bright, black = cells[shown & ~dark], cells[shown & dark]
    if not len(bright) or not len(black):
        return {"read_percent": 0.0, "contrast": float("nan"), "separation": float("nan")}
    right = read_right(cells, dark)
    high, low = float(bright.mean()), float(black.mean())
    spread = float(np.sqrt((bright.var() + black.var()) / 2.0))
    total = high + low
    return {
        "read_percent": 100.0 * float(right.mean()),
        "contrast": (high - low) / total if total else float("nan"),
        "separation": (high - low) / spread if spread else float("inf"),
    }


def read_right(cells: F64, dark: Bool) -> Bool:
    """Which cells (cell,) are on the right side of the threshold; none where fewer than two are shown."""
    shown = np.isfinite(cells)
    return (
        shown & ((cells < otsu(cells[shown])) == dark)
        if shown.sum() > 1
        else np.zeros(len(cells), dtype=np.bool_)
    )


def otsu(values: F64) -> float:
    """The threshold that parts values into two groups with the largest variance between them."""
    ordered = np.sort(values)
    count, low = np.arange(1, len(ordered)), np.cumsum(ordered)[:-1]
    between = (
        (low / count - (ordered.sum() - low) / (len(ordered) - count)) ** 2
        * count
        * (len(ordered) - count)
    )
    best = int(between.argmax())
    return float(ordered[best] + ordered[best + 1]) / 2.0
