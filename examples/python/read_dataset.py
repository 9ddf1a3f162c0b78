#!/usr/bin/env python3
"""Read a data set without sabench: read_dataset.py DATASET.

Project every particle of frame 0 into every (true) camera, and print the largest difference from
its pixel in truth.h5, which is rounding. For one plane wall, or none; needs numpy, h5py, tifffile.
"""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import tifffile

sys.path.insert(0, str(Path(__file__).resolve().parent))
from synthetic_aperture import project


def main(dataset):
    """Print image size, type and largest difference of each camera."""
    root = Path(dataset)
    rig = json.loads((root / "cameras.json").read_text(encoding="utf-8"))
    true = root / "true_cameras.json"
    if true.exists():
        rig |= json.loads(true.read_text(encoding="utf-8"))
    with h5py.File(root / "truth.h5") as truth:
        points = truth["frames/0000/position_mm"][...]
        for camera in rig["cameras"]:
            name = camera["name"]
            image = tifffile.imread(root / f"images/frame_0000/{name}.tif")
            pixel = truth[f"frames/0000/cameras/{name}/pixel"][...]
            error = np.column_stack(list(project(camera, rig["wall"], points))) - pixel
            worst = np.nanmax(np.abs(error))
            print(name, image.shape, image.dtype, f"worst error {worst:.1e} px")


if __name__ == "__main__":
    main(*sys.argv[1:])
