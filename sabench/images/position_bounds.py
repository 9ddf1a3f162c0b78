"""Cramer-Rao bounds of particles' positions: how exactly the images fix them.

A particle has four unknowns: its position, and one factor of its light in all cameras. Its image in
a camera is a Gaussian, averaged over pixels. Particles whose images overlap share unknowns, so that
each bound is that of a fit in which the neighbours are unknown, too. The neighbours' own
neighbours are taken as known: a bound with fewer unknowns is lower, and so remains a bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from scipy.spatial import cKDTree

from sabench.images.gaussians import fill_shares, fill_slopes
from sabench.utils.arrays import F64, I64

_REACH = 4.0  # standard deviations from the centre of an image to its window's edge
_OVERLAP = 2.5  # standard deviations of both: distance of images that overlap
_WIDEST = 32  # px: half a window
_UNKNOWNS = 4  # logarithm of the light, and position
# share of its information by which each unknown of a neighbour is known before, so that neighbours
# that one camera alone sees make no matrix singular
_KNOWN = 1e-9
_SINGULAR = 1e-12  # share of an unknown's information that must be left beside the others


@dataclass(frozen=True)
class ParticleSpots:
    """Images of n particles in one camera.

    Attributes
    ----------
    pixel : (n, 2) column, row of the centres; NaN where there is none.
    slope : (n, 2, 3) derivatives of the centre by the position, px/mm.
    light : (n,) integral of the image; 0 where the camera does not see the particle.
    sigma_px : (n,) standard deviation.
    variance : (row, column) of the pixels' noise, in the square of the unit of the light; infinite
        where a pixel tells nothing.
    """

    pixel: F64
    slope: F64
    light: F64
    sigma_px: F64
    variance: F64


def position_bounds(cameras: Sequence[ParticleSpots], rows: I64) -> F64:
    """Compute the least covariances (k, 3, 3) mm2 of some unbiased positions.

    NaN where the images do not fix the position. Source: Cramer-Rao inequality with the Fisher
    information of normal noise of known variance.
    """
    pairs, blocks = zip(*(_information(camera) for camera in cameras), strict=True)
    keys = np.concatenate([np.zeros((0, 2), dtype=np.int64), *pairs])
    every = np.concatenate([np.zeros((0, _UNKNOWNS, _UNKNOWNS)), *blocks])
    count = len(cameras[0].pixel)
    unique, place = np.unique(keys[:, 0] * count + keys[:, 1], return_inverse=True)
    order = np.argsort(place, kind="stable")
    starts = np.searchsorted(place[order], np.arange(len(unique)))
    summed = np.add.reduceat(every[order], starts) if len(every) else every
    first = np.searchsorted(unique, np.arange(count + 1) * count)
    bounds: F64 = _invert(first, unique % max(count, 1), summed, np.asarray(rows, dtype=np.int64))
    return bounds


def _information(camera: ParticleSpots) -> tuple[I64, F64]:
    """Compute the Fisher information of all pairs of images that overlap.

    Returns rows (p, 2) of particles, in both orders and with themselves, and blocks (p, 4, 4) of
    logarithm of the light and position.
    """
    seen = np.flatnonzero((camera.light > 0.0) & np.isfinite(camera.pixel).all(axis=1))
    reach = _REACH * camera.sigma_px[seen]
    seen = seen[reach + 1.0 < _WIDEST]
    if not len(seen):
        return np.zeros((0, 2), dtype=np.int64), np.zeros((0, _UNKNOWNS, _UNKNOWNS))
    half = np.ceil(_REACH * camera.sigma_px[seen] + 0.5).astype(np.int64)
    pixel = camera.pixel[seen]
    sigma = camera.sigma_px[seen]
    near = cKDTree(pixel).query_pairs(2.0 * _OVERLAP * float(sigma.max()), output_type="ndarray")
    apart = np.linalg.norm(pixel[near[:, 0]] - pixel[near[:, 1]], axis=1)
    near = near[apart < _OVERLAP * sigma[near].sum(axis=1)]
    own = np.arange(len(seen))
    pairs = np.concatenate([np.column_stack([own, own]), near, near[:, ::-1]]).astype(np.int64)
    weight = 1.0 / camera.variance
    inner = _overlaps(pairs, pixel, camera.light[seen], sigma, half, weight)
    kept = np.abs(inner).max(axis=(1, 2)) > 0.0
    pairs, inner = pairs[kept], inner[kept]
    chain = np.zeros((len(seen), 3, _UNKNOWNS))
    chain[:, :2, 1:] = camera.slope[seen]
    chain[:, 2, 0] = 1.0
    left, right = chain[pairs[:, 0]], chain[pairs[:, 1]]
    blocks = np.einsum("pia,pij,pjb->pab", left, inner, right)
    return seen[pairs], blocks


@numba.njit(cache=True)
def _overlaps(
    pairs: Any, pixel: Any, light: Any, sigma: Any, half: Any, weight: Any
) -> Any:  # pragma: no cover
    """Sum products (p, 3, 3) of two images' derivatives over common pixels.

    The derivatives are those by column, row and logarithm of the light.
    """
    rows, columns = weight.shape
    size = 2 * half.max() + 1
    count = len(pixel)
    grey = np.zeros((count, 2, size))
    slope = np.zeros((count, 2, size))
    first = np.zeros((count, 2), dtype=np.int64)
    for i in range(count):
        for axis in range(2):
            first[i, axis] = int(np.rint(pixel[i, axis])) - half[i]
            width = 2 * half[i] + 1
            fill_shares(pixel[i, axis], sigma[i], first[i, axis], grey[i, axis, :width])
            fill_slopes(pixel[i, axis], sigma[i], first[i, axis], slope[i, axis, :width])
    out = np.zeros((len(pairs), 3, 3))
    one, other = np.zeros(3), np.zeros(3)
    for p in range(len(pairs)):
        i, j = pairs[p]
        left = max(first[i, 0], first[j, 0], 0)
        right = min(first[i, 0] + 2 * half[i], first[j, 0] + 2 * half[j], columns - 1)
        top = max(first[i, 1], first[j, 1], 0)
        bottom = min(first[i, 1] + 2 * half[i], first[j, 1] + 2 * half[j], rows - 1)
        for row in range(top, bottom + 1):
            yi, yj = row - first[i, 1], row - first[j, 1]
            for column in range(left, right + 1):
                xi, xj = column - first[i, 0], column - first[j, 0]
                one[0] = light[i] * slope[i, 0, xi] * grey[i, 1, yi]
                one[1] = light[i] * grey[i, 0, xi] * slope[i, 1, yi]
                one[2] = light[i] * grey[i, 0, xi] * grey[i, 1, yi]
                other[0] = light[j] * slope[j, 0, xj] * grey[j, 1, yj]
                other[1] = light[j] * grey[j, 0, xj] * slope[j, 1, yj]
                other[2] = light[j] * grey[j, 0, xj] * grey[j, 1, yj]
                for a in range(3):
                    for b in range(3):
                        out[p, a, b] += weight[row, column] * one[a] * other[b]
    return out


@numba.njit(cache=True)
def _invert(first: Any, partners: Any, blocks: Any, rows: Any) -> Any:  # pragma: no cover
    """Invert the information of positions whose partners are fitted, too."""
    out = np.full((len(rows), 3, 3), np.nan)
    for k in range(len(rows)):
        i = rows[k]
        near = partners[first[i] : first[i + 1]].copy()
        if len(near) == 0:
            continue
        # itself last: the end of the Cholesky factor is then that of the Schur complement
        at = np.searchsorted(near, i)
        near[at:-1] = near[at + 1 :]
        near[-1] = i
        size = _UNKNOWNS * len(near)
        matrix = np.zeros((size, size))
        for a in range(len(near)):
            start, end = first[near[a]], first[near[a] + 1]
            for b in range(a + 1):
                place = start + np.searchsorted(partners[start:end], near[b])
                if place < end and partners[place] == near[b]:
                    top, left = _UNKNOWNS * a, _UNKNOWNS * b
                    matrix[top : top + _UNKNOWNS, left : left + _UNKNOWNS] = blocks[place]
        for a in range(size - _UNKNOWNS):
            matrix[a, a] *= 1.0 + _KNOWN
        if _factorise(matrix):
            own = np.ascontiguousarray(matrix[-3:, -3:])
            for a in range(3):
                own[a, a + 1 :] = 0.0
            inverse = np.linalg.inv(own)
            out[k] = inverse.T @ inverse
    return out


@numba.njit(cache=True, fastmath={"reassoc", "contract"})  # vectorised sums
def _factorise(matrix: Any) -> bool:  # pragma: no cover
    """Replace the lower triangle by the Cholesky factor; False if it is singular."""
    for i in range(len(matrix)):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = total / matrix[j, j]
            elif total > _SINGULAR * matrix[i, i]:
                matrix[i, i] = math.sqrt(total)
            else:
                return False
    return True
