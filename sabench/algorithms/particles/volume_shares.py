"""Shares of the searched volume that the pixels of cameras show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64, I64, Bool

# points that tell shares, and which cameras see a pixel's part of the box, and those in a block of
# pixels on average
_FOR_SHARES, _FOR_VIEWS, _EACH = 140_000, 400_000, 16
_LONELY = 0.05  # of a pixel's part of the box, which few cameras see
# powers of the root of x^4 = x + 1: points that fill a cube evenly (M. Roberts, The unreasonable
# effectiveness of quasirandom sequences, 2018)
_STEP = 1.2207440846057596 ** -np.arange(1.0, 4.0)


def volume_shares(maps: VolumePolynomials, shape: tuple[int, ...]) -> F64:
    """Compute the shares (camera, row, column) of the maps' box that the pixels show.

    They are counts of points that fill the box evenly, in blocks of pixels, interpolated.
    """
    out = np.zeros((len(maps.coefficients), *shape))
    for block, share in zip(_blocks(maps, shape, _FOR_SHARES), out, strict=True):
        counts = np.bincount(block.of[block.shown], minlength=block.rows * block.columns)
        blocks = counts.reshape(block.rows, block.columns) / (_FOR_SHARES * block.edge**2)
        size = block.columns * block.edge, block.rows * block.edge
        fine = cv2.resize(blocks, size, interpolation=cv2.INTER_LINEAR)
        share[:] = fine[: shape[0], : shape[1]]
    return out


def shared_views(maps: VolumePolynomials, shape: tuple[int, ...], fewest: int) -> Bool:
    """Mark pixels (camera, row, column) whose part of the box enough cameras see.

    At least `fewest` of them, that one included, see nearly all of it. Pixels that show nothing of
    the box are marked, too.
    """
    blocks = list(_blocks(maps, shape, _FOR_VIEWS))
    lonely = np.sum([block.shown for block in blocks], axis=0) < fewest
    out = np.zeros((len(blocks), *shape), dtype=np.bool_)
    for block, marked in zip(blocks, out, strict=True):
        size = block.rows * block.columns
        all_points = np.bincount(block.of[block.shown], minlength=size)
        few = np.bincount(block.of[block.shown & lonely], minlength=size)
        shared = few <= _LONELY * all_points
        fine = shared.reshape(block.rows, block.columns).repeat(block.edge, 0).repeat(block.edge, 1)
        marked[:] = fine[: shape[0], : shape[1]]
    return out


class _Blocks(NamedTuple):
    """Blocks of `edge` pixels of a camera, and the one `of` each point shown (n,)."""

    edge: int
    rows: int
    columns: int
    of: I64
    shown: Bool


def _blocks(maps: VolumePolynomials, shape: tuple[int, ...], count: int) -> Iterator[_Blocks]:
    """Find the blocks of each camera's pixels that hold `count` points in the box."""
    points = 2.0 * ((np.arange(count)[:, None] * _STEP) % 1.0) - 1.0
    edge = math.ceil(math.sqrt(_EACH * math.prod(shape) / count))
    rows, columns = (math.ceil(size / edge) for size in shape)
    for camera in range(len(maps.coefficients)):
        pixels = project_points(maps, camera, points)
        column, row = np.floor((pixels + 0.5) / edge).astype(np.int64).T
        shown = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        yield _Blocks(edge, rows, columns, row * columns + column, shown)
