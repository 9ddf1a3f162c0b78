"""Cramer-Rao bound of a calibration's observations."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ellipe

from sabench.algorithms.calibration import any_wall, bundle_adjustment as bundle
from sabench.algorithms.calibration.bundle_adjustment import BoardImages
from sabench.algorithms.calibration.kernels import BOARD
from sabench.algorithms.calibration.normal_equations import spreads
from sabench.algorithms.calibration.parameters import FreeParameters, State
from sabench.geometry.rigid_motion import skew
from sabench.utils.arrays import F64, Bool


@dataclass(frozen=True)
class Limit:
    """Smallest standard deviations of any unbiased estimate, in the wall's frame.

    Attributes
    ----------
    reprojection_px : mean length of the true reprojection error over all observations.
    reprojection_rms_px : its root mean square.
    point_std_mm : (3,) scatter of the points' errors about their mean, after the points have been
        aligned by a shift in X and Y and a rotation about Z.
    point_mean_mm : (3,) of the mean error; along X and Y it is zero by that alignment.
    shared_std : (s,) of what all cameras share, in the order of `FreeParameters.columns`: indices,
        thicknesses (mm), tilt (rad) and place (mm) of the wall, bend (mm); infinite where nothing
        shows it.
    unknowns, equations : their numbers, what is left open not counted.
    """

    reprojection_px: float
    reprojection_rms_px: float
    point_std_mm: F64
    point_mean_mm: F64
    shared_std: F64
    unknowns: int
    equations: int

    @property
    def efficiency(self) -> float:
        """True over measured error of a perfect estimate: sqrt(p / (N - p))."""
        return float(np.sqrt(self.unknowns / max(self.equations - self.unknowns, 1)))


def compute_bound(state: State, views: BoardImages, free: FreeParameters, noise_px: float) -> Limit:
    """Compute the bound at the true state for pixel coordinates with normal noise."""
    information = _whole(state, views, free)
    covariance, rank, shown = _inverse(information)
    covariance *= noise_px**2
    size = len(covariance) - BOARD * len(state.board_positions)
    shared = np.arange(size - len(free.columns(len(state.indices))[1]), size)
    variances = np.where(shown, np.diagonal(covariance), np.inf)[shared]
    pairs = _spreads(state, views, free, covariance)
    uu, vv, uv = pairs[np.isfinite(pairs[..., 0])].T
    lengths = float(_mean_length(uu, vv, uv).mean()), float(np.sqrt((uu + vv).mean()))
    points = _points(state, views, covariance)
    return Limit(*lengths, *points, np.sqrt(variances), rank, 2 * len(uu))


def _spreads(state: State, views: BoardImages, free: FreeParameters, covariance: F64) -> F64:
    """Compute covariances (M, K, m, 3) of computed pixels: column, row and both."""
    pair = views.pixels, views.weights
    if not free.cameras:
        boards = BOARD * len(state.board_positions)
        slopes = block_diag(bundle.follow_wall(state, free), np.eye(boards))
        covariance = slopes @ covariance @ slopes.T
    if views.frame is not None:
        return any_wall.spreads(views.frame, state, views.board, pair, free, covariance)
    columns = free.columns(len(state.indices))
    return np.asarray(spreads(state.array(), state.boards(views.board), pair, columns, covariance))


def _whole(state: State, views: BoardImages, free: FreeParameters) -> F64:
    """Compute the information of cameras, shared unknowns and boards at 1 px."""
    normal = bundle.normal_equations(state, views, free)
    size, boards = len(normal.aa), len(normal.bb)
    whole = np.zeros((size + BOARD * boards, size + BOARD * boards))
    whole[:size, :size] = normal.aa
    for k in range(boards):
        part = slice(size + BOARD * k, size + BOARD * (k + 1))
        whole[:size, part], whole[part, :size] = normal.ab[k], normal.ab[k].T
        whole[part, part] = normal.bb[k]
    return whole


def _inverse(information: F64) -> tuple[F64, int, Bool]:
    """Compute a generalised inverse, the rank, and which unknowns are determined.

    Quantities that do not depend on the undetermined directions have the same variance in any of
    these inverses.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information * scale * scale[:, None])
    rounding = np.finfo(np.float64).eps
    nonzero = values > len(values) * rounding * values[-1]  # the others are open
    half = scale[:, None] * vectors[:, nonzero] / np.sqrt(values[nonzero])
    shown = np.sum(vectors[:, ~nonzero] ** 2, axis=1) < np.sqrt(rounding)
    return half @ half.T, int(nonzero.sum()), shown


def _points(state: State, views: BoardImages, covariance: F64) -> tuple[F64, F64]:
    """Compute the scatter and mean error of all visible points after alignment."""
    boards = np.flatnonzero(views.weights.sum(axis=(0, 2)) > 0.0)
    size = len(covariance) - BOARD * len(state.board_positions)
    index = (size + BOARD * boards[:, None] + np.arange(BOARD)).ravel()
    values, vectors = np.linalg.eigh(covariance[np.ix_(index, index)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # R R^T = covariance, in spite of rounding
    points = state.points(views.board)[boards]
    slopes = np.zeros((*points.shape, len(index)))  # of every coordinate by the boards' unknowns
    arms = points - state.board_positions[boards, None]
    for k in range(len(boards)):
        slopes[k, :, :, BOARD * k : BOARD * k + 3] = -skew(arms[k])
        slopes[k, :, :, BOARD * k + 3 : BOARD * (k + 1)] = np.eye(3)
    errors = slopes.reshape(-1, len(index)) @ root  # of coordinates, by independent unit variables
    flat = points.reshape(-1, 3)
    motions = np.zeros((len(flat), 3, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = 1.0
    motions[:, :, 2] = np.column_stack([-flat[:, 1], flat[:, 0], np.zeros(len(flat))])
    basis, _ = np.linalg.qr(motions.reshape(-1, 3))
    errors = (errors - basis @ (basis.T @ errors)).reshape(-1, 3, len(index))
    mean = errors.mean(axis=0)
    return np.sqrt(((errors - mean) ** 2).sum(axis=2).mean(axis=0)), np.sqrt((mean**2).sum(axis=1))


def _mean_length(uu: F64, vv: F64, uv: F64) -> F64:
    """Compute mean lengths of pairs of normal numbers from their covariances."""
    middle, spread = (uu + vv) / 2.0, np.hypot((uu - vv) / 2.0, uv)
    large, small = middle + spread, np.maximum(middle - spread, 0.0)
    flattening = 1.0 - small / np.maximum(large, 1e-300)
    return np.asarray(np.sqrt(2.0 * large / np.pi) * ellipe(flattening))
