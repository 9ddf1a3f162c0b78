"""Particles that stand alone in the images, and tell what all are like."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import numba
from sabench.utils.threads import share_rows

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
    pixels = np.stack([project_points(maps, camera, position) for camera in range(len(sigma))])
    border = (_BORDER * sigma.max(axis=1))[:, None, None]
    last = np.array(shape[::-1]) - 1.0
    inside = ((pixels > border) & (pixels < last - border)).all(axis=(0, 2))
    reach = _OVERLAP * sigma.max(axis=1)
    starts, near = near_images(pixels, reach)
    overlap = np.zeros(len(position))

    def add(rows: slice) -> None:
        _add_overlap(rows.start, pixels, light, sigma, reach, starts, near, overlap[rows])

    share_rows(add, len(position))
    least = np.sort(np.where(inside, overlap, np.inf))
    rank = min(max(_LEAST_ALONE, int(_ALONE * len(overlap))), len(overlap) - 1)
    most = max(least[rank], _HARDLY * len(sigma))
    return np.flatnonzero(inside & (overlap <= most))


@numba.njit(cache=True, nogil=True)
def _add_overlap(
    first: int,
    pixels: Any,
    light: Any,
    sigma: Any,
    reach: Any,
    starts: Any,
    near: Any,
    overlap: Any,
) -> None:
    """Add up the light of near images over the particles' own, from the first row on."""
    for k in range(len(overlap)):
        n = first + k
        for other in near[starts[n] : starts[n + 1]]:
            for c in range(len(sigma)):
                x = pixels[c, n, 0] - pixels[c, other, 0]
                y = pixels[c, n, 1] - pixels[c, other, 1]
                if x * x + y * y <= reach[c] ** 2:
                    apart = 0.25 * ((x / sigma[c, 0]) ** 2 + (y / sigma[c, 1]) ** 2)
                    overlap[k] += math.exp(-apart) * light[other, c] / light[n, c]
