"""Straight vortices with a rate of rotation that depends on distance only."""

import numpy as np

from sabench.geometry.rigid_motion import frame_along, skew
from sabench.utils.arrays import F64


def lateral(
    points_mm: F64, center_mm: tuple[float, float, float], axis: tuple[float, float, float]
) -> tuple[F64, F64, F64]:
    """Compute offsets of points from an axis.

    Returns offsets (n, 3), their lengths (n,), and the axis as a unit vector.
    """
    along = frame_along(axis)[2]
    offset = points_mm - np.asarray(center_mm)
    offset -= (offset @ along)[:, None] * along
    return offset, np.linalg.norm(offset, axis=1), along


def turning(offset: F64, along: F64, rate: F64) -> F64:
    """Compute velocities (n, 3) of rotation at rates (n,) in rad/s."""
    return np.asarray(rate[:, None] * np.cross(along, offset))


def turning_gradient(offset: F64, along: F64, rate: F64, slope: F64) -> F64:
    """Compute gradients (n, 3, 3) of a straight vortex.

    `slope` (n,) is the rate's derivative by the distance, over the distance.
    """
    shear = np.einsum("n,ni,nj->nij", slope, np.cross(along, offset), offset)
    return np.asarray(rate[:, None, None] * skew(along) + shear)
