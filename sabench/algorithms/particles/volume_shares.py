"""Shares of the searched volume that the pixels of cameras show."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64

_POINTS, _EACH = 400_000, 16  # points, and those in a block of pixels on average
# powers of the root of x^4 = x + 1: points that fill a cube evenly (M. Roberts, The unreasonable
# effectiveness of quasirandom sequences, 2018)
_STEP = 1.2207440846057596 ** -np.arange(1.0, 4.0)


def volume_shares(maps: VolumePolynomials, shape: tuple[int, ...]) -> F64:
    """Compute the shares (camera, row, column) of the maps' box that the pixels show.

    They are counts of points that fill the box evenly, in blocks of pixels, interpolated.
    """
    points = 2.0 * ((np.arange(_POINTS)[:, None] * _STEP) % 1.0) - 1.0
    edge = math.ceil(math.sqrt(_EACH * math.prod(shape) / _POINTS))
    rows, columns = (math.ceil(size / edge) for size in shape)
    out = np.zeros((len(maps.coefficients), *shape))
    for camera, share in enumerate(out):
        pixels = project_points(maps, camera, points)
        column, row = np.floor((pixels + 0.5) / edge).astype(np.int64).T
        shown = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        counts = np.bincount(row[shown] * columns + column[shown], minlength=rows * columns)
        blocks = counts.reshape(rows, columns) / (_POINTS * edge**2)
        fine = cv2.resize(blocks, (columns * edge, rows * edge), interpolation=cv2.INTER_LINEAR)
        share[:] = fine[: shape[0], : shape[1]]
    return out
