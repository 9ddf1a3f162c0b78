"""Compose the picture of README from figures of the thesis: python docs/images/front.py.

`sabench reproduce fig-1-3 fig-6-5 --figures docs/images` draws the figures.
"""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

_FOLDER = Path(__file__).parent
_HEIGHT, _GAP = 330, 14


class Panel(NamedTuple):
    """A part of a figure: its file, its box (left, top, right, bottom) in pixels, its caption."""

    figure: str
    box: tuple[int, int, int, int]
    caption: str


PANELS = (
    Panel("fig-6-5", (58, 52, 544, 477), "a liquid jet, one of 9 cameras"),
    Panel("fig-6-5", (58, 548, 544, 967), "refocused at one depth"),
    Panel("fig-1-3", (566, 93, 843, 300), "a code behind bubbles, one of 25 cameras"),
    Panel("fig-1-3", (514, 415, 894, 701), "refocused on the code"),
)


def tile(panel: Panel) -> npt.NDArray[np.uint8]:
    """A panel of fixed height with its caption below and a margin to the right."""
    figure = cv2.imread(str(_FOLDER / f"{panel.figure}.png"), cv2.IMREAD_GRAYSCALE)
    assert figure is not None, panel.figure
    left, top, right, bottom = panel.box
    width = round((right - left) * _HEIGHT / (bottom - top))
    picture = cv2.resize(figure[top:bottom, left:right], (width, _HEIGHT))
    picture = cv2.copyMakeBorder(picture, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=128.0)
    strip = np.full((34, picture.shape[1]), 255, dtype=np.uint8)
    cv2.putText(strip, panel.caption, (4, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.58, 0, 1, cv2.LINE_AA)
    return np.asarray(
        np.pad(np.vstack([picture, strip]), ((0, 0), (0, _GAP)), constant_values=255),
        dtype=np.uint8,
    )


def main() -> None:
    """All panels in a row."""
    row = np.hstack([tile(panel) for panel in PANELS])[:, :-_GAP]
    path = str(_FOLDER / "front.png")
    cv2.imwrite(path, row, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
