"""Rotations, rigid motions, a volume's box and bodies' poses in the world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64


def rotation_matrices(vectors: F64) -> F64:
    """Compute rotation matrices of rotation vectors (..., 3) by Rodrigues' formula.

    The matrices are (..., 3, 3). scipy's `Rotation.from_rotvec` goes by quaternions and differs in
    the last digit, which would change every data set with a rotation in it.
    """
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = skew(vectors)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def skew(vectors: F64) -> F64:
    """Compute the matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    out = np.zeros((*vectors.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        out[..., row, column] = vectors[..., axis]
        out[..., column, row] = -vectors[..., axis]
    return out


def frame_along(axis: tuple[float, float, float]) -> F64:
    """Make a right-handed frame (3, 3) with a third row along an axis.

    The axis may be of any length. The first row is as near to X as it can be.
    """
    third = np.asarray(axis, dtype=np.float64)
    return frame_of_normal(third / np.linalg.norm(third))


def frame_of_normal(normal: F64) -> F64:
    """Make a right-handed frame (3, 3) with a unit vector as its third row.

    The first row is as near to X as it can be.
    """
    x = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    second = cross(normal, x)
    second /= np.linalg.norm(second)
    return np.stack([cross(second, normal), second, normal])


def cross(first: F64, second: F64) -> F64:
    """Compute the cross product of two vectors (3,).

    numpy.cross, which takes any shapes, needs ten times as long for so little, to the same bits.
    """
    a, b, c = first.tolist()
    d, e, f = second.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])


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


@dataclass(frozen=True)
class Domain:
    """Box that a generator fills, along the world's axes.

    Attributes
    ----------
    center_mm, size_mm : centre and edges of the box in the world frame.
    pixels : pixels of one camera's image, for densities per pixel.
    """

    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    pixels: int

    @property
    def low_mm(self) -> F64:
        """Corner (3,) with the smallest coordinates."""
        return np.asarray(self.center_mm) - np.asarray(self.size_mm) / 2.0

    @property
    def volume_mm3(self) -> float:
        """Volume of the box."""
        return float(np.prod(self.size_mm))


@dataclass(frozen=True)
class Pose:
    """Rotation and position of a target: the map x -> rotation x + position_mm.

    Attributes
    ----------
    rotation : (3, 3) from the target's frame to the world's.
    position_mm : (3,) the target's own origin in the world frame.
    """

    rotation: F64
    position_mm: F64

    def __call__(self, points_mm: F64) -> F64:
        """Compute world points (n, 3) of points in the target's frame."""
        return np.asarray(points_mm @ self.rotation.T + self.position_mm)
