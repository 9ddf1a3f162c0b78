"""Rigid motions and their least-squares fits to points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.geometry.rotations import exponential
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Motion:
    """x -> turn x + shift.

    Attributes
    ----------
    turn : (3, 3) rotation.
    shift : (3,) mm.
    """

    turn: F64
    shift: F64

    def __call__(self, points_mm: F64) -> F64:
        """Points (..., 3), moved."""
        return np.asarray(points_mm @ self.turn.T + self.shift)

    def back(self) -> Motion:
        """The opposite motion."""
        return Motion(self.turn.T, -self.turn.T @ self.shift)


def rigid_fit(points: F64, targets: F64) -> Motion:
    """The motion of points (n, 3) that brings them nearest to targets (n, 3), in the least-squares sense.

    Source: Kabsch (1976), by the singular value decomposition.
    """
    middle, goal = points.mean(axis=0), targets.mean(axis=0)
    left, _, right = np.linalg.svd((targets - goal).T @ (points - middle))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return Motion(turn, goal - turn @ middle)


def lateral_fit(points: F64, targets: F64) -> Motion:
    """The turn about Z and shift in X and Y of points (n, 3) that bring them nearest to targets (n, 3)."""
    middle, goal = points.mean(axis=0), targets.mean(axis=0)
    (x, y), (p, q) = (points - middle).T[:2], (targets - goal).T[:2]
    angle = np.arctan2(np.sum(x * q - y * p), np.sum(x * p + y * q))
    turn = exponential(np.array([0.0, 0.0, angle]))
    return Motion(turn, np.append((goal - turn @ middle)[:2], 0.0))
