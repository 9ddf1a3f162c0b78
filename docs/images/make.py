"""Compose a sheet of the pictures that a suite leaves of a case.

Run python docs/images/make.py leaderboard/pictures/FOLDER docs/images/NAME.png.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

_SIDE, _GAP = 400, 12
_CAPTIONS = {"images": "what the cameras record", "truth": "truth, a slice"}


def tile(path: Path, caption: str) -> npt.NDArray[np.uint8]:
    """A square picture with a line of text below it and a margin to the right."""
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert grey is not None, path
    picture = np.asarray(
        cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA), dtype=np.uint8
    )
    strip = np.full((34, _SIDE), 255, dtype=np.uint8)
    cv2.putText(strip, caption, (4, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 0, 1, cv2.LINE_AA)
    return np.asarray(
        np.pad(np.vstack([picture, strip]), ((0, 0), (0, _GAP)), constant_values=255),
        dtype=np.uint8,
    )


def main(folder: Path, sheet: Path) -> None:
    """Cameras, truth and each solver, four beside each other."""
    solvers = sorted(path for path in folder.glob("*-????????.png"))  # and no .error.png
    tiles = [tile(folder / f"{stem}.png", caption) for stem, caption in _CAPTIONS.items()]
    tiles += [tile(path, path.stem.rsplit("-", 1)[0]) for path in solvers]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % 4)
    rows = [np.hstack(tiles[first : first + 4]) for first in range(0, len(tiles), 4)]
    cv2.imwrite(str(sheet), np.vstack(rows)[:, :-_GAP], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
