"""Derivatives of vector fields: gradients on lattices, curl and divergence."""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64, Bool


def gradient(velocity: F64, step_mm: tuple[float, float, float]) -> F64:
    """Compute gradients du_i / dx_j of a field on a lattice by central differences.

    Parameters
    ----------
    velocity : (z, y, x, 3).
    step_mm : spacing of the nodes along x, y, z.

    Returns
    -------
    (z, y, x, 3, 3), one-sided differences at the lattice's ends, NaN along axes of a single node.
    """
    parts: list[F64] = []
    for axis in range(3):
        along = 2 - axis  # x varies along the last of the first three
        if velocity.shape[along] < 2:
            parts.append(np.full(velocity.shape, np.nan))
        else:
            parts.append(np.asarray(np.gradient(velocity, step_mm[axis], axis=along)))
    return np.stack(parts, axis=-1)


def inner(shape: tuple[int, int, int]) -> Bool:
    """Mark the nodes (z, y, x) of a lattice whose differences are central ones.

    Axes of a single node do not count.
    """
    out = np.zeros(shape, dtype=np.bool_)
    out[tuple(slice(1, -1) if count > 1 else slice(None) for count in shape)] = True
    return out


def vorticity(gradient: F64) -> F64:
    """Compute the curl (..., 3) of a field with gradients (..., 3, 3), du_i / dx_j."""
    parts = [gradient[..., i, j] - gradient[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return np.stack(parts, axis=-1)


def divergence(gradient: F64) -> F64:
    """Compute the divergence (...) of a field with gradients (..., 3, 3)."""
    return np.asarray(np.trace(gradient, axis1=-2, axis2=-1))
