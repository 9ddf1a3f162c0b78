"""Compose docs/images/demo.png from the pictures that `make demo` leaves: python docs/images/make.py leaderboard/pictures/FOLDER"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

_SIDE = 400


def tile(path: Path, caption: str) -> npt.NDArray[np.uint8]:
    """A square picture with a line of text below it."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grey is not None, path
    picture = np.asarray(cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    strip = np.full((34, _SIDE), 255, dtype=np.uint8)
    cv2.putText(strip, caption, (4, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 0, 1, cv2.LINE_AA)
    return np.vstack([picture, strip])


def main(folder: Path) -> None:
    """Cameras, truth and each solver side by side."""
    solvers = sorted(folder.glob("msa-*.png")) + sorted(folder.glob("asa-*.png"))
    names = {"msa": "multiplicative synthetic aperture", "asa": "additive synthetic aperture"}
    tiles = [tile(folder / "images.png", "what nine cameras record"), tile(folder / "truth.png", "truth, a slice")]
    tiles += [tile(path, names[path.name.split("-")[0]]) for path in solvers]
    gap = np.full((tiles[0].shape[0], 12), 255, dtype=np.uint8)
    sheet = np.hstack([part for picture in tiles for part in (picture, gap)][:-1])
    cv2.imwrite(str(Path(__file__).with_name("demo.png")), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
