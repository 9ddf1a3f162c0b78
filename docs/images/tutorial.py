"""Draw the pictures of the tutorial from the files that its commands make.

Run python docs/images/tutorial.py work/data work/msa.h5 [FOLDER]; the page's own are in
docs/images, others in the current folder by default.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

import sabench
from sabench.api import Reconstruction
from sabench.apps.viewer.contents import of_dataset
from sabench.plotting.kinds import KINDS, rgb
from sabench.plotting.pictures import montage

_WINDOW = slice(40, 130), slice(80, 230)  # rows and columns of voxels: a part of the volume
_ZOOM = 6  # pixels of a voxel
# shapes and sizes in pixels; None: a circle of this radius
_MARKS = {
    "found": (None, 15),
    "missed": (cv2.MARKER_DIAMOND, 32),
    "ghost": (cv2.MARKER_TILTED_CROSS, 26),
    "duplicate": (cv2.MARKER_TRIANGLE_UP, 28),
}


def seen_from_front(volume: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Brightest voxel along Z in the window, 0 to 1."""
    flat = volume.max(axis=0)[_WINDOW].astype(np.float64)
    return np.asarray(np.clip(flat / np.percentile(flat, 99.8), 0.0, 1.0) ** 0.5)


def main(data: str, result: str, folder: str = ".") -> None:
    """Write the images of all cameras, and the result over the truth."""
    dataset = sabench.open_dataset(data)
    images = dataset.observation(0).images
    levels = dataset.scene.sensor
    (Path(folder) / "tutorial-images.png").write_bytes(
        montage(images, levels.black_level_dn, float(levels.white_dn))
    )
    found = sabench.open_result(result, dataset)
    grey = np.asarray(255.0 * seen_from_front(found.read(Reconstruction).volume), dtype=np.uint8)
    sheet = cv2.resize(grey, None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_NEAREST)
    sheet = cv2.cvtColor(sheet, cv2.COLOR_GRAY2BGR)
    cloud = of_dataset(dataset, found).frames[0].particles
    corner = np.array([_WINDOW[1].start, _WINDOW[0].start])
    places = (found.grid.to_voxels(cloud.position_mm)[:, :2] - corner + 0.5) * _ZOOM
    for kind, (mark, size) in _MARKS.items():
        for place in np.rint(places[cloud.kind == KINDS.index(kind)]).astype(int).tolist():
            if mark is None:
                cv2.circle(sheet, place, size, rgb(kind)[::-1], 2, cv2.LINE_AA)
            else:
                cv2.drawMarker(sheet, place, rgb(kind)[::-1], mark, size, 2, cv2.LINE_AA)
    cv2.imwrite(str(Path(folder) / "tutorial-ghosts.png"), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(*sys.argv[1:])
