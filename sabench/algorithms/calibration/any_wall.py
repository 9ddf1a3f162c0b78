"""Bundles of projections through any walls.

The cameras themselves project, and derivatives are central differences: slower than the kernels of
`normal_equations`, for any wall. Results are as there.
"""

import math

import numpy as np

from sabench.algorithms.calibration.kernels import BOARD, CAMERA
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.utils.arrays import F64

# of a camera's unknowns as in `kernels.observe`, whose first are like a board's: far above
# rounding, far below any curvature
_STEPS = np.array([1e-5] * 3 + [1e-2] * 3 + [1.0] * 3 + [1e-3] * (CAMERA - 9))

Equations = tuple[float, F64, F64, F64, F64, F64]
Seen = tuple[F64, F64]  # pixels (M, K, m, 2) and weights (M, K, m)


def _project(frame: WallFrame, state: State, board: F64) -> F64:
    """Project all boards' points (m, 3) into all cameras: pixels (M, K, m, 2)."""
    points = frame.points(state, board)
    pixels = [camera.project(points.reshape(-1, 3))[0] for camera in frame.build_cameras(state)]
    return np.stack(pixels).reshape(len(pixels), *points.shape[:2], 2)


def misses(frame: WallFrame, state: State, board: F64, views: Seen) -> F64:
    """Subtract computed from observed pixels (M, K, m, 2); NaN without a path."""
    return np.asarray(views[0] - _project(frame, state, board))


def equations(
    frame: WallFrame, state: State, board: F64, views: Seen, free: FreeParameters, scale: float
) -> Equations:
    """Sum normal equations of all observations; see `normal_equations.equations`."""
    error, weights = misses(frame, state, board, views), views[1]
    used = weights > 0.0
    cameras, count = weights.shape[:2]
    size = cameras * free.per_camera
    aa, ab = np.zeros((size, size)), np.zeros((count, size, BOARD))
    bb, a, d = np.zeros((count, BOARD, BOARD)), np.zeros(size), np.zeros((count, BOARD))
    if not np.isfinite(error[used]).all():
        return math.inf, aa, ab, bb, a, d
    error = np.where(used[..., None], error, 0.0)
    square, loss = np.sum(error**2, axis=-1), weights
    if scale > 0.0:
        cost = float(np.sum(weights * scale**2 * np.log1p(square / scale**2)))
        loss = weights / (1.0 + square / scale**2)
    else:
        cost = float(np.sum(weights * square))
    slopes = np.where(used[..., None, None], _slopes(frame, state, board, free), 0.0)
    for camera, (slope, miss, weight) in enumerate(zip(slopes, error, loss, strict=True)):
        part = slice(camera * free.per_camera, (camera + 1) * free.per_camera)
        by_camera, by_board = np.split(slope, [free.per_camera], axis=-1)
        heavy = weight[..., None, None] * by_camera
        aa[part, part] = np.einsum("kmxp,kmxq->pq", heavy, by_camera)
        ab[:, part] = np.einsum("kmxp,kmxq->kpq", heavy, by_board)
        a[part] = np.einsum("kmxp,kmx->p", heavy, miss)
        heavy = weight[..., None, None] * by_board
        bb += np.einsum("kmxp,kmxq->kpq", heavy, by_board)
        d += np.einsum("kmxp,kmx->kp", heavy, miss)
    return cost, aa, ab, bb, a, d


def spreads(
    frame: WallFrame, state: State, board: F64, views: Seen, free: FreeParameters, covariance: F64
) -> F64:
    """Compute covariances (M, K, m, 3) as `normal_equations.spreads` does."""
    cameras, count = views[1].shape[:2]
    slopes, base = _slopes(frame, state, board, free), cameras * free.per_camera
    out = np.full((*views[1].shape, 3), math.nan)
    for camera in range(cameras):
        camera_columns = np.arange(free.per_camera) + camera * free.per_camera
        for number in range(count):
            columns = np.concatenate([camera_columns, base + number * BOARD + np.arange(BOARD)])
            rows = slopes[camera, number]
            both = rows @ covariance[np.ix_(columns, columns)] @ rows.transpose(0, 2, 1)
            out[camera, number] = np.stack([both[:, 0, 0], both[:, 1, 1], both[:, 0, 1]], axis=1)
    return np.where(views[1][..., None] > 0.0, out, math.nan)


def _slopes(frame: WallFrame, state: State, board: F64, free: FreeParameters) -> F64:
    """Differentiate pixels (M, K, m, 2) by unknowns (f + BOARD)."""
    columns, none = [], np.zeros(0)
    camera_columns, _ = free.columns(len(state.indices))
    for number, step in enumerate(np.append(_STEPS[camera_columns], _STEPS[:BOARD]).tolist()):
        cameras = np.zeros((len(state.rotations), len(camera_columns)))
        boards = np.zeros((len(state.board_rotations), BOARD))
        if number < len(camera_columns):
            cameras[:, number] = step
        else:
            boards[:, number - len(camera_columns)] = step
        ahead = _project(frame, state.apply_steps(cameras, none, boards, free), board)
        back = _project(frame, state.apply_steps(-cameras, none, -boards, free), board)
        columns.append((ahead - back) / (2.0 * step))
    return np.stack(columns, axis=-1)
