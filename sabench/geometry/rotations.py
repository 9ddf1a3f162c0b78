"""Rotations from small vectors."""

import numpy as np

from sabench.utils.arrays import F64


def rotation_matrices(vectors: F64) -> F64:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = skew(vectors)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def skew(vectors: F64) -> F64:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2
    )


def frame_along(axis: tuple[float, float, float]) -> F64:
    """A right-handed frame (3, 3) whose third row points along an axis of any length; the first is as near to X as it can be."""
    third = np.asarray(axis, dtype=np.float64)
    third = third / np.linalg.norm(third)
    x = np.array([1.0, 0.0, 0.0]) if abs(third[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    second = np.cross(third, x)
    second /= np.linalg.norm(second)
    return np.stack([np.cross(second, third), second, third])
