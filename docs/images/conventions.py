"""Draw the frames and the pixels of docs/conventions.md: python docs/images/conventions.py."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

_TRUE, _DARK = "#1f5fa8", "#333333"


def arrow(axes: Any, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    """An arrow of an axis with its name at the end."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": _TRUE, "lw": 1.8})
    beyond = [e + 0.13 * (e - s) for s, e in zip(start, end, strict=True)]
    axes.text(*beyond, text, color=_TRUE, ha="center", va="center", fontsize=12)


def frames(axes: Any) -> None:
    """The tank from the side: cameras in air, the wall at Z = 0, the volume in the fluid."""
    axes.fill_between([0.0, 0.25], -3.0, 3.0, color="#cfe8d5")
    axes.fill_between([0.25, 5.0], -3.0, 3.0, color="#dcebf7")
    axes.add_patch(plt.Rectangle((2.2, -1.0), 1.2, 2.0, fill=False, color=_DARK, lw=1.5))
    axes.text(2.8, 1.2, "volume", ha="center", color=_DARK)
    axes.text(0.12, -3.35, "wall: layers", ha="center", color=_DARK)
    axes.text(3.4, -2.7, "fluid_index", ha="center", color=_DARK)
    axes.text(-3.6, -2.7, "air_index", ha="center", color=_DARK)
    arrow(axes, (0.0, 0.0), (1.5, 0.0), "Z")
    arrow(axes, (0.0, 0.0), (0.0, -1.5), "Y")
    axes.plot(0.0, 0.0, "o", color=_TRUE, ms=9, mfc="white")
    axes.plot(0.0, 0.0, ".", color=_TRUE, ms=6)
    axes.text(-0.3, -0.35, "X out of\nthe page", ha="right", color=_TRUE)
    axes.plot([-4.2], [2.0], "ko", ms=6)
    axes.text(-4.2, 2.4, "pinhole, center_mm", ha="center", color=_DARK)
    axes.plot([-4.2, 0.0, 0.25, 2.8], [2.0, 0.75, 0.70, 0.13], color="#b4542b", lw=1.2)
    axes.set(xlim=(-5.6, 5.0), ylim=(-3.7, 3.0), aspect="equal")
    axes.set_title("world frame (side view) and a line of sight")
    axes.axis("off")


def pixels(axes: Any) -> None:
    """The first pixels of an image: column to the right, row down, centres at whole numbers."""
    for edge in range(5):
        axes.plot([-0.5, 3.5], [edge - 0.5] * 2, color="#999999", lw=1.0)
        axes.plot([edge - 0.5] * 2, [-0.5, 3.5], color="#999999", lw=1.0)
    for column in range(4):
        for row in range(4):
            axes.plot(column, row, ".", color=_DARK, ms=4)
    axes.text(0.06, -0.1, "(0, 0)", fontsize=10, color=_DARK)
    axes.text(2.06, 0.9, "(2, 1)", fontsize=10, color=_DARK)
    axes.text(-0.75, -0.62, "(-0.5, -0.5)", fontsize=10, color=_DARK, ha="center")
    arrow(axes, (-0.5, -0.9), (2.2, -0.9), "column")
    arrow(axes, (-0.9, -0.5), (-0.9, 2.2), "row")
    axes.set(xlim=(-1.6, 3.7), ylim=(3.7, -1.3), aspect="equal")
    axes.set_title("pixels: (column, row) of the centres")
    axes.axis("off")


def main() -> None:
    """Both drawings side by side."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), width_ratios=(1.6, 1.0))
    frames(left)
    pixels(right)
    figure.tight_layout(pad=1.5)
    figure.savefig(Path(__file__).with_name("conventions.png"), dpi=110)


if __name__ == "__main__":
    main()
