"""Normal equations, residuals and covariances of a bundle of projections."""

import math
from typing import Any

import numpy as np

from sabench.algorithms.calibration.kernels import BEND, BOARD, CAMERA, observe
from sabench.utils.compiled import inner_kernel, numba


@inner_kernel()
def _rotate(rotation: Any, point: Any, lever: Any) -> None:
    for axis in range(3):
        row = rotation[axis]
        lever[axis] = row[0] * point[0] + row[1] * point[1] + row[2] * point[2]


@inner_kernel()
def _bend(row: Any, rotation: Any, lift: Any, start: int) -> None:
    """Fill in derivatives by the bend, which lifts a point along the normal."""
    for i in range(2):
        move = row[i, CAMERA + 3 : CAMERA + 6]
        along = move[0] * rotation[0, 2] + move[1] * rotation[1, 2] + move[2] * rotation[2, 2]
        for j in range(BEND):
            row[i, start + j] = along * lift[j]


@inner_kernel()
def _scratch(media: int) -> Any:
    """Make `observe`'s row and work arrays, and a lever."""
    row = np.zeros((2, CAMERA + BOARD + 2 * media + 1 + BEND))
    return row, np.zeros((3, media)), np.zeros(3)


@inner_kernel()
def _columns(camera_columns: Any, shared: Any) -> Any:
    """List the columns of `observe`'s rows for camera, shared and board unknowns."""
    f, s = len(camera_columns), len(shared)
    pick = np.empty(f + s + BOARD, dtype=np.int64)
    for i in range(f):
        pick[i] = camera_columns[i]
    for i in range(s):
        pick[f + i] = CAMERA + BOARD + shared[i]
    for i in range(BOARD):
        pick[f + s + i] = CAMERA + i
    return pick


@numba.njit(cache=True)
def equations(array: Any, boards: Any, views: Any, free: Any, scale: float) -> Any:
    """Sum normal equations of all observations, with the boards' unknowns in blocks.

    Parameters
    ----------
    array : rotations (M, 3, 3), centres (M, 3), lenses (M, 10), media.
    boards : rotations (K, 3, 3), positions (K, 3), points on a board (m, 3), and how far each
        unknown of its bend lifts them (m, BEND).
    views : pixels (M, K, m, 2) and weights (M, K, m); what has no weight is not looked at.
    free : columns of a camera (f,) that are unknowns, and of what all cameras share, counted from 0
        (s,).
    scale : of Cauchy's loss scale^2 log(1 + e^2 / scale^2), px; 0 for e^2.

    Returns
    -------
    cost : sum of weighted losses; infinite if a weighted point has no path.
    aa : (M f + s, M f + s) of cameras and what they share; ab : (K, M f + s, BOARD); bb : (K,
        BOARD, BOARD).
    a, d : (M f + s,) and (K, BOARD), minus the gradients.
    """
    rotations, centers, lenses, media = array
    board_rotations, positions, points, lifts = boards
    pixels, weights = views
    camera_columns, shared = free
    cameras, count, dots = weights.shape
    f, s, m = len(camera_columns), len(shared), len(media[0])
    size, local = cameras * f + s, f + s + BOARD
    aa, ab = np.zeros((size, size)), np.zeros((count, size, BOARD))
    bb, a, d = np.zeros((count, BOARD, BOARD)), np.zeros(size), np.zeros((count, BOARD))
    row, work, lever = _scratch(m)
    pick = _columns(camera_columns, shared)
    part, slope, chosen = np.zeros((local, local)), np.zeros(local), np.zeros((2, local))
    cost = 0.0
    for c in range(cameras):
        for k in range(count):
            part[:], slope[:] = 0.0, 0.0
            for i in range(dots):
                weight = weights[c, k, i]
                if weight == 0.0:
                    continue
                _rotate(board_rotations[k], points[i], lever)
                u, v, ok = observe(
                    rotations[c], centers[c], lenses[c], media, lever, positions[k], row, work
                )
                if not ok:
                    return math.inf, aa, ab, bb, a, d
                _bend(row, board_rotations[k], lifts[i], CAMERA + BOARD + 2 * m + 1)
                eu, ev = pixels[c, k, i, 0] - u, pixels[c, k, i, 1] - v
                square = eu * eu + ev * ev
                if scale > 0.0:
                    cost += weight * scale * scale * math.log1p(square / (scale * scale))
                    weight /= 1.0 + square / (scale * scale)
                else:
                    cost += weight * square
                for p in range(local):
                    chosen[0, p], chosen[1, p] = row[0, pick[p]], row[1, pick[p]]
                for p in range(local):
                    gu, gv = weight * chosen[0, p], weight * chosen[1, p]
                    slope[p] += gu * eu + gv * ev
                    for q in range(p + 1):
                        part[p, q] += gu * chosen[0, q] + gv * chosen[1, q]
            _scatter(part, slope, c, k, (f, s, cameras), (aa, ab, bb, a, d))
    return cost, aa, ab, bb, a, d


@inner_kernel()
def _scatter(part: Any, slope: Any, c: int, k: int, counts: Any, sums: Any) -> None:
    """Add the lower triangle of one camera's and one board's equations."""
    (f, s, cameras), (aa, ab, bb, a, d) = counts, sums
    for p in range(f + s):
        here = c * f + p if p < f else cameras * f + p - f
        a[here] += slope[p]
        for q in range(f + s):
            column = c * f + q if q < f else cameras * f + q - f
            aa[here, column] += part[p, q] if q <= p else part[q, p]
        for q in range(BOARD):
            ab[k, here, q] += part[f + s + q, p]
    for p in range(BOARD):
        d[k, p] += slope[f + s + p]
        for q in range(BOARD):
            bb[k, p, q] += part[f + s + p, f + s + q] if q <= p else part[f + s + q, f + s + p]


@numba.njit(cache=True)
def misses(array: Any, boards: Any, views: Any) -> Any:
    """Subtract computed from observed pixels (M, K, m, 2); NaN without a path."""
    rotations, centers, lenses, media = array
    board_rotations, positions, points, _ = boards
    pixels, _ = views
    out = np.full(pixels.shape, math.nan)
    row, work, lever = _scratch(len(media[0]))
    for c in range(pixels.shape[0]):
        for k in range(pixels.shape[1]):
            for i in range(pixels.shape[2]):
                _rotate(board_rotations[k], points[i], lever)
                u, v, ok = observe(
                    rotations[c], centers[c], lenses[c], media, lever, positions[k], row, work
                )
                if ok:
                    out[c, k, i, 0] = pixels[c, k, i, 0] - u
                    out[c, k, i, 1] = pixels[c, k, i, 1] - v
    return out


@numba.njit(cache=True)
def spreads(array: Any, boards: Any, views: Any, free: Any, covariance: Any) -> Any:
    """Compute covariances (M, K, m, 3) of pixels: column, row, both."""
    rotations, centers, lenses, media = array
    board_rotations, positions, points, lifts = boards
    _, weights = views
    camera_columns, shared = free
    cameras, count, dots = weights.shape
    f, s, m = len(camera_columns), len(shared), len(media[0])
    local, base = f + s + BOARD, cameras * f + s
    row, work, lever = _scratch(m)
    out = np.full((cameras, count, dots, 3), math.nan)
    part, pick = np.zeros((local, local)), _columns(camera_columns, shared)
    index = np.empty(local, dtype=np.int64)
    for c in range(cameras):
        for k in range(count):
            for p in range(local):
                shift = cameras * f - f if p < f + s else base + k * BOARD - f - s
                index[p] = p + (c * f if p < f else shift)
            for p in range(local):
                for q in range(local):
                    part[p, q] = covariance[index[p], index[q]]
            for i in range(dots):
                if weights[c, k, i] == 0.0:
                    continue
                _rotate(board_rotations[k], points[i], lever)
                _, _, ok = observe(
                    rotations[c], centers[c], lenses[c], media, lever, positions[k], row, work
                )
                if not ok:
                    continue
                _bend(row, board_rotations[k], lifts[i], CAMERA + BOARD + 2 * m + 1)
                uu, vv, uv = 0.0, 0.0, 0.0
                for p in range(local):
                    u, v = 0.0, 0.0
                    for q in range(local):
                        u += part[p, q] * row[0, pick[q]]
                        v += part[p, q] * row[1, pick[q]]
                    uu += row[0, pick[p]] * u
                    vv += row[1, pick[p]] * v
                    uv += row[0, pick[p]] * v
                out[c, k, i, 0], out[c, k, i, 1], out[c, k, i, 2] = uu, vv, uv
    return out
