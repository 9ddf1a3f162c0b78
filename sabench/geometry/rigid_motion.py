"""Rigid motions and their least-squares fits to points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.geometry.rotations import rotation_matrices
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class RigidMotion:
    """Map x -> rotation x + shift.

    Attributes
    ----------
    rotation : (3, 3).
    shift : (3,) mm.
    """

    rotation: F64
    shift: F64

    def __call__(self, points_mm: F64) -> F64:
        """Move points (..., 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.shift)

    @classmethod
    def none(cls) -> RigidMotion:
        """Make the motion that moves nothing."""
        return cls(np.eye(3), np.zeros(3))

    @property
    def is_none(self) -> bool:
        """Truth of a motion that moves nothing."""
        return bool((self.rotation == np.eye(3)).all() and not self.shift.any())

    def after(self, first: RigidMotion) -> RigidMotion:
        """Compose with a motion that comes first."""
        if self.is_none:
            return first
        return RigidMotion(self.rotation @ first.rotation, self(first.shift))

    def inverse(self) -> RigidMotion:
        """Invert the motion."""
        return RigidMotion(self.rotation.T, -self.rotation.T @ self.shift)


def fit_rigid_motion(points: F64, targets: F64) -> RigidMotion:
    """Fit the motion that brings points nearest to targets, by least squares.

    Points and targets are (n, 3). Source: Kabsch (1976), by the singular value decomposition.
    """
    middle, goal = points.mean(axis=0), targets.mean(axis=0)
    left, _, right = np.linalg.svd((targets - goal).T @ (points - middle))
    rotation = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return RigidMotion(rotation, goal - rotation @ middle)


def fit_lateral_motion(points: F64, targets: F64) -> RigidMotion:
    """Fit rotation about Z and shift in X and Y of points (n, 3) to targets (n, 3).

    It is what a plane wall at constant Z does not notice; the fit is one of least squares.
    """
    middle, goal = points.mean(axis=0), targets.mean(axis=0)
    (x, y), (p, q) = (points - middle).T[:2], (targets - goal).T[:2]
    angle = np.arctan2(np.sum(x * q - y * p), np.sum(x * p + y * q))
    rotation = rotation_matrices(np.array([0.0, 0.0, angle]))
    return RigidMotion(rotation, np.append((goal - rotation @ middle)[:2], 0.0))
