"""Particles that stand alone in the images, and tell what all are like."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64, I64

_OVERLAP = 4.8  # widths of images: distance of those that overlap
_ALONE, _LEAST_ALONE, _HARDLY = 0.03, 60, 0.1  # share, number and overlap of lone particles
_FEW = 30  # particles that tell nothing of all
_BORDER = 4.8  # widths: distance from the border where images are not complete


def find_lone(
    maps: VolumePolynomials, position: F64, light: F64, sigma: F64, shape: tuple[int, ...]
) -> I64:
    """Find particles whose images overlap with others' the least, and are complete.

    Parameters
    ----------
    position, light : (n, 3) in the box of the maps, (n, camera).
    sigma : (camera, 2) widths of images.
    shape : rows and columns of the images.
    """
    if len(position) < _FEW:
        return np.zeros(0, dtype=np.int64)
    overlap = np.zeros(len(position))
    inside = np.ones(len(position), dtype=bool)
    last = np.array(shape[::-1]) - 1.0
    for camera, width in enumerate(sigma):
        pixels = project_points(maps, camera, position)
        i, j = cKDTree(pixels).query_pairs(_OVERLAP * width.max(), output_type="ndarray").T
        apart = np.sum((pixels[i] - pixels[j]) ** 2 / (4.0 * width**2), axis=1)
        shared, own = np.exp(-apart), light[:, camera]
        np.add.at(overlap, i, shared * own[j] / own[i])
        np.add.at(overlap, j, shared * own[i] / own[j])
        border = _BORDER * width.max()
        inside &= ((pixels > border) & (pixels < last - border)).all(axis=1)
    least = np.sort(np.where(inside, overlap, np.inf))
    rank = min(max(_LEAST_ALONE, int(_ALONE * len(overlap))), len(overlap) - 1)
    most = max(least[rank], _HARDLY * len(sigma))
    return np.flatnonzero(inside & (overlap <= most))
