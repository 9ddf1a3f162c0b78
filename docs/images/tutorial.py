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
from sabench.metrics.reconstruction_error import true_field
from sabench.plotting.pictures import montage

_WINDOW = slice(40, 130), slice(80, 230)  # rows and columns of voxels: a part of the volume
_ZOOM = 6  # pixels of a voxel


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
    volume = found.read(Reconstruction).volume
    truth = true_field(found.grid, dataset.particles(0), dataset.views(0))
    true = seen_from_front(truth)
    estimate = cv2.dilate(seen_from_front(volume), np.ones((3, 3)))  # as wide as true particles
    colours = np.stack([true, true, estimate], axis=-1)  # blue, green, red
    sheet = cv2.resize(
        np.asarray(255.0 * colours, dtype=np.uint8),
        None,
        fx=_ZOOM,
        fy=_ZOOM,
        interpolation=cv2.INTER_NEAREST,
    )
    cv2.imwrite(str(Path(folder) / "tutorial-ghosts.png"), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(*sys.argv[1:])
