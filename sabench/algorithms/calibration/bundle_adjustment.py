"""Bundle adjustment of cameras, boards and shared unknowns.

The method is Levenberg and Marquardt's. The boards' blocks are eliminated first (Schur's
complement), so that a step needs a Cholesky factor of the cameras' unknowns only. Source: Triggs et
al. (2000), Bundle adjustment - a modern synthesis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sabench.algorithms.calibration import any_wall, parameters
from sabench.algorithms.calibration.kernels import BEND
from sabench.algorithms.calibration.normal_equations import equations, misses
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.geometry.rigid_motion import RigidMotion, skew
from sabench.utils.arrays import F64


def follow_wall(state: State, free: FreeParameters) -> F64:
    """Differentiate cameras' and shared unknowns by the shared ones.

    In the frame of the wall, cameras that are known in the world move when the wall does: a turn r
    and a shift z of the wall R x + t move a point x by -R^-1 (r x R x + z), see
    `State.apply_steps`.

    Returns (M f + s, s).
    """
    camera_columns, shared = free.columns(len(state.indices))
    rows = np.zeros((len(state.rotations), len(camera_columns), len(shared)))
    if free.wall:
        first = int(np.flatnonzero(shared == 2 * len(state.indices) - 2)[0])
        part, back = slice(first, first + parameters.WALL), state.wall.rotation.T
        arms = skew(state.centers @ back)
        rows[:, 0:3, part][..., :2] = (state.rotations @ back)[..., :2]
        rows[:, 3:6, part] = back @ np.concatenate(
            [arms[..., :2], np.broadcast_to(-np.eye(3)[:, 2:], (len(arms), 3, 1))], axis=2
        )
    return np.vstack([rows.reshape(-1, len(shared)), np.eye(len(shared))])


STEPS = 200  # at most
HARDLY = 1e-9  # relative decrease of the cost, and damping, that change nothing


Moving = Literal["all", "cameras", "boards"]


@dataclass(frozen=True)
class BoardImages:
    """Images of the boards in the cameras.

    Attributes
    ----------
    board : (m, 3) points in a board's own frame, mm.
    pixels : (M, K, m, 2) column and row; anything where the weight is 0.
    weights : (M, K, m).
    anchors : known positions; empty for none.
    prior : what is known of the unknowns that all cameras share; None for nothing.
    frame : of cameras that are not behind one plane wall, see `Frame.beyond_kernels`.
    """

    board: F64
    pixels: F64
    weights: F64
    anchors: tuple[Anchor, ...] = ()
    frame: WallFrame | None = None
    prior: SharedPrior | None = None

    @cached_property
    def anchored(self) -> tuple[Any, ...]:
        """Boards, points (n,), positions, precisions (n, 3) and motions to the world."""
        rows = [
            (a.board, a.point, a.position_mm, a.precision, a.world.rotation, a.world.shift)
            for a in self.anchors
        ]
        return tuple(np.array(column) for column in zip(*rows, strict=True))


@dataclass(frozen=True)
class Anchor:
    """Point with a measured position in the world.

    Attributes
    ----------
    board, point : numbers.
    position_mm : (3,) in the world's frame; anything along axes without precision.
    precision : (3,) inverse variance along the world's axes, 1 / mm^2, times the variance of a
        pixel coordinate; 0 where the position is not known.
    world : from the nominal wall's frame to the world's.
    """

    board: int
    point: int
    position_mm: F64
    precision: F64
    world: RigidMotion


@dataclass(frozen=True)
class SharedPrior:
    """Nominal values of what all cameras share, in the order of `State.shared`.

    Attributes
    ----------
    mean : (n,) values.
    precision : (n,) inverse variances, times the variance of a pixel coordinate.
    """

    mean: F64
    precision: F64


@dataclass(frozen=True)
class Normal:
    """Normal equations at a state; see `normal_equations.equations`."""

    cost: float
    aa: F64
    ab: F64
    bb: F64
    a: F64
    d: F64


@dataclass(frozen=True)
class Fit:
    """State, its cost and the steps that led to it."""

    state: State
    cost: float
    steps: int
    converged: bool


def normal_equations(
    state: State, views: BoardImages, free: FreeParameters, scale: float = 0.0
) -> Normal:
    """Compute the equations of one Gauss-Newton step."""
    pair, columns = (views.pixels, views.weights), free.columns(len(state.indices))
    if views.frame is not None:
        normal = Normal(*any_wall.equations(views.frame, state, views.board, pair, free, scale))
    else:
        boards = state.boards(views.board)
        normal = Normal(*equations(state.array(), boards, pair, columns, scale))
    if views.anchors:
        normal = _with_anchors(normal, state, views, free)
    if views.prior is not None:
        shared = columns[1]
        rows = np.arange(len(normal.aa) - len(shared), len(normal.aa))
        precision = views.prior.precision[shared]
        miss = (views.prior.mean - state.shared)[shared]
        normal.aa[rows, rows] += precision
        normal.a[rows] += precision * miss
        normal = replace(normal, cost=normal.cost + float(np.sum(precision * miss**2)))
    if free.cameras:
        return normal
    slopes = follow_wall(state, free)  # cameras are known: only the shared unknowns stay
    return replace(
        normal,
        aa=slopes.T @ normal.aa @ slopes,
        ab=np.einsum("ps,kpb->ksb", slopes, normal.ab),
        a=slopes.T @ normal.a,
    )


def _with_anchors(normal: Normal, state: State, views: BoardImages, free: FreeParameters) -> Normal:
    """Add the known places to the equations."""
    board, point, position_mm, precision, rotations, shifts = views.anchored
    bent = state.bend_board(views.board)
    arms = np.einsum("nij,nj->ni", state.board_rotations[board], bent[point])
    turned = (arms + state.board_positions[board]) @ state.wall.rotation.T
    nominal = turned + state.wall.shift
    miss = position_mm - np.einsum("nij,nj->ni", rotations, nominal) - shifts
    by_board = np.concatenate([-skew(arms), np.broadcast_to(np.eye(3), (len(arms), 3, 3))], axis=2)
    slopes = rotations @ state.wall.rotation @ by_board
    weighted = slopes * precision[:, :, None]
    np.add.at(normal.bb, board, weighted.transpose(0, 2, 1) @ slopes)
    np.add.at(normal.d, board, np.einsum("nij,ni->nj", weighted, miss))
    if free.wall or free.bend:
        levers = [
            -skew(turned)[:, :, :2],
            np.broadcast_to(np.eye(3)[:, 2:], (len(arms), 3, 1)),
            (state.wall.rotation @ state.board_rotations[board])[:, :, 2:]
            * parameters.bend_lifts(views.board)[point][:, None],
        ]
        chosen = np.repeat([free.wall, free.wall, free.bend], [2, 1, BEND])
        by_shared = (rotations @ np.concatenate(levers, axis=2))[:, :, chosen]
        heavy = by_shared * precision[:, :, None]
        tail = slice(len(normal.aa) - by_shared.shape[2], None)
        normal.aa[tail, tail] += np.einsum("nip,niq->pq", heavy, by_shared)
        normal.a[tail] += np.einsum("nip,ni->p", heavy, miss)
        np.add.at(normal.ab[:, tail], board, heavy.transpose(0, 2, 1) @ slopes)
    return replace(normal, cost=normal.cost + float(np.sum(precision * miss**2)))


def refine(
    state: State,
    views: BoardImages,
    free: FreeParameters,
    scale: float = 0.0,
    *,
    moving: Moving = "all",
) -> Fit:
    """Find the state with the smallest cost near to this one.

    Parameters
    ----------
    scale : of Cauchy's loss, px; 0 for least squares.
    moving : what is adjusted: cameras (with what they share), boards, or both.

    Motions that the observations do not determine stay near the start. For a plane wall these are
    a shift along it and a rotation about its normal.
    """
    here, damping = normal_equations(state, views, free, scale), 1e-3
    for step in range(STEPS):
        if not math.isfinite(here.cost):
            return Fit(state, here.cost, step, False)
        while damping < 1e12:
            cameras, boards, promise = _step(here, damping, moving)
            if promise <= HARDLY * here.cost:
                return Fit(state, here.cost, step, True)
            steps = parameters.steps_of(cameras, len(state.rotations), free, len(state.indices))
            tried = state.apply_steps(*steps, boards, free)
            normal = normal_equations(tried, views, free, scale)
            if normal.cost < here.cost:
                state, here, damping = tried, normal, max(damping * 0.1, 1e-12)
                break
            damping *= 10.0
        else:
            return Fit(state, here.cost, step, False)
    return Fit(state, here.cost, STEPS, False)


def promised_gain(normal: Normal) -> float:
    """Compute the decrease of the cost by a step, if the cost is quadratic."""
    return _step(normal, HARDLY, "all")[2]


def _step(normal: Normal, damping: float, moving: Moving) -> tuple[F64, F64, float]:
    """Solve for steps of cameras and boards (K, 6), and the fall of a quadratic cost."""
    aa, bb = normal.aa.copy(), normal.bb.copy()
    aa.flat[:: len(aa) + 1] += damping * np.diagonal(aa) + 1e-30
    corner = np.arange(bb.shape[1])
    bb[:, corner, corner] += damping * bb[:, corner, corner] + 1e-12
    cameras, boards = np.zeros_like(normal.a), np.zeros_like(normal.d)
    if moving == "cameras":
        cameras = _solve_damped(aa, normal.a)
    elif moving == "boards":
        boards = np.asarray(np.linalg.solve(bb, normal.d[:, :, None])[:, :, 0])
    else:
        right = np.concatenate([normal.ab.transpose(0, 2, 1), normal.d[:, :, None]], axis=2)
        solved = np.linalg.solve(bb, right)  # bb^-1 ab^T and bb^-1 d
        size = len(aa)
        flat = normal.ab.transpose(1, 0, 2).reshape(size, -1)
        reduced = aa - np.dot(flat, solved[:, :, :-1].reshape(-1, size))
        free = normal.a - np.dot(flat, solved[:, :, -1].reshape(-1, 1))[:, 0]
        cameras = _solve_damped(reduced, free)
        boards = solved[:, :, -1] - solved[:, :, :-1] @ cameras
    return cameras, boards, float(cameras @ normal.a + np.sum(boards * normal.d))


def _solve_damped(matrix: F64, right: F64) -> F64:
    """Solve a positive definite system, scaled to a unit diagonal."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    scaled = matrix * scale * scale[:, None]
    try:
        factor = cho_factor(scaled, check_finite=False)
        return np.asarray(scale * cho_solve(factor, scale * right, check_finite=False))
    except np.linalg.LinAlgError:
        return np.asarray(scale * np.linalg.lstsq(scaled, scale * right, rcond=None)[0])


def residuals(state: State, views: BoardImages) -> F64:
    """Subtract computed from observed pixels (M, K, m, 2); NaN without a path."""
    pair = views.pixels, views.weights
    if views.frame is not None:
        return any_wall.misses(views.frame, state, views.board, pair)
    out: F64 = misses(state.array(), state.boards(views.board), pair)
    return out
