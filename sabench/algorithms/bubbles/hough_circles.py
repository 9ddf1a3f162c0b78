"""Votes for outlines by Hough's transform.

A vote is the part of a circle around a pixel that is an edge from dark inside to bright outside.

The direction of the gradient counts and its strength hardly does, as in Loy and Zelinsky's radial
symmetry (IEEE PAMI 25, 2003): a faint bubble with a complete outline has more votes than one
strong edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from sabench.utils.arrays import F32, F64

_STEP = 1.13  # between radii
_WIDTH = 0.6  # px: of the ring
_WEAK = 0.04  # transmission per px: a gradient that counts half
_SMOOTH = 0.6  # px


@dataclass(frozen=True)
class Votes:
    """Votes (radius, row, column) from 0 to 1 of one image, and the radii in px.

    They are stretched downwards until ellipses of an aspect are circles.
    """

    radii_px: F64
    maps: F32
    aspect: float = 1.0

    def map_pixels(self, pixels: F64) -> F64:
        """Map pixels (n, 2) to positions in the maps."""
        return np.column_stack([pixels[:, 0], (pixels[:, 1] + 0.5) / self.aspect - 0.5])


def radii_between(smallest_px: float, largest_px: float) -> F64:
    """List the radii that are tried."""
    count = max(2, int(np.ceil(np.log(largest_px / smallest_px) / np.log(_STEP))) + 1)
    return np.geomspace(smallest_px, largest_px, count)


def vote(image: F32, radii_px: F64, aspect: float = 1.0) -> Votes:
    """Vote for circles in one image of transmission.

    With an aspect (short over long axis), vote for ellipses that lie flat.
    """
    if aspect != 1.0:
        image = cv2.resize(
            image, (image.shape[1], round(image.shape[0] / aspect)), interpolation=cv2.INTER_CUBIC
        )
    smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTH)
    right = cv2.Sobel(
        smooth, cv2.CV_32F, 1, 0, ksize=3, scale=0.125, borderType=cv2.BORDER_REPLICATE
    )
    down = cv2.Sobel(
        smooth, cv2.CV_32F, 0, 1, ksize=3, scale=0.125, borderType=cv2.BORDER_REPLICATE
    )
    strength = cv2.magnitude(right, down) + np.float32(_WEAK)
    right /= strength
    down /= strength
    maps = np.empty((len(radii_px), *image.shape), dtype=np.float32)
    for out, radius in zip(maps, radii_px, strict=True):
        across, along = _ring(float(radius))
        cv2.filter2D(right, cv2.CV_32F, across, dst=out, borderType=cv2.BORDER_CONSTANT)
        out += cv2.filter2D(down, cv2.CV_32F, along, borderType=cv2.BORDER_CONSTANT)
    return Votes(radii_px, maps, aspect)


def _ring(radius: float) -> tuple[F32, F32]:
    """Make kernels that add up the outward parts of a field on a ring."""
    half = int(np.ceil(radius + 3.0 * _WIDTH))
    x, y = np.meshgrid(
        np.arange(-half, half + 1, dtype=np.float64), np.arange(-half, half + 1, dtype=np.float64)
    )
    distance = np.hypot(x, y)
    weight = np.exp(-((distance - radius) ** 2) / (2.0 * _WIDTH**2))
    weight[half, half] = 0.0
    weight /= weight.sum()
    safe = np.maximum(distance, 1e-9)
    return (weight * x / safe).astype(np.float32), (weight * y / safe).astype(np.float32)


def peaks(votes: Votes, least: float, margin: int = 1) -> F64:
    """Find local maxima over position and radius.

    Returns (n, 4): column, row, radius in px, vote.
    """
    maps = votes.maps
    spatial = np.stack(
        [cv2.dilate(one, np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8)) for one in maps]
    )
    around = spatial.copy()
    around[1:] = np.maximum(around[1:], spatial[:-1])
    around[:-1] = np.maximum(around[:-1], spatial[1:])
    scale, row, column = np.nonzero((maps >= around) & (maps > least))
    there = (row + 0.5) * votes.aspect - 0.5
    return np.column_stack([column, there, votes.radii_px[scale], maps[scale, row, column]]).astype(
        np.float64
    )
