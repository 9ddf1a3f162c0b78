"""Rotation matrices of rotation vectors, and frames along an axis."""

import numpy as np

from sabench.utils.arrays import F64


def rotation_matrices(vectors: F64) -> F64:
    """Compute rotation matrices of rotation vectors (..., 3) by Rodrigues' formula.

    The matrices are (..., 3, 3). scipy's `Rotation.from_rotvec` goes by quaternions and differs in
    the last digit, by which every data set with a rotation in it would change.
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
    made = np.zeros((*vectors.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        made[..., row, column] = vectors[..., axis]
        made[..., column, row] = -vectors[..., axis]
    return made


def frame_along(axis: tuple[float, float, float]) -> F64:
    """Make a right-handed frame (3, 3) whose third row points along an axis.

    The axis may be of any length. The first row is as near to X as it can be.
    """
    third = np.asarray(axis, dtype=np.float64)
    return frame_of_normal(third / np.linalg.norm(third))


def frame_of_normal(normal: F64) -> F64:
    """Make a right-handed frame (3, 3) whose third row is a unit vector.

    The first row is as near to X as it can be.
    """
    x = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    second = cross(normal, x)
    second /= np.linalg.norm(second)
    return np.stack([cross(second, normal), second, normal])


def cross(one: F64, other: F64) -> F64:
    """Compute the cross product of two vectors (3,).

    numpy.cross, which takes any shapes, needs ten times as long for so little, to the same bits.
    """
    a, b, c = one.tolist()
    d, e, f = other.tolist()
    return np.array([b * f - c * e, c * d - a * f, a * e - b * d])
