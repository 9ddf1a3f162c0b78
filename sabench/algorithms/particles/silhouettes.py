"""Pixels in which cameras see the volume that is searched."""

from __future__ import annotations

import cv2
import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import Bool

_NODES = 9  # along each edge of the box: lines of sight bend little between them


def silhouettes(maps: VolumePolynomials, shape: tuple[int, ...]) -> Bool:
    """Mark the pixels (camera, row, column) in the outline of the maps' box."""
    ends = np.linspace(-1.0, 1.0, _NODES)
    lattice = np.stack(np.meshgrid(ends, ends, ends), axis=-1).reshape(-1, 3)
    out = np.zeros((len(maps.coefficients), *shape), dtype=np.uint8)
    far = 2.0**14  # pixels beyond which an outline may bend: OpenCV takes no larger numbers
    for camera, image in enumerate(out):
        pixels = np.clip(project_points(maps, camera, lattice), -far, far)
        hull = cv2.convexHull(pixels.astype(np.float32))
        cv2.fillConvexPoly(image, np.rint(hull).astype(np.int32), 1)
        image[:] = cv2.dilate(image, np.ones((3, 3), np.uint8))  # rounding cuts off corners
    return out > 0
