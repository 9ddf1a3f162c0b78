"""Positions of the cameras of an array.

All functions return offsets (n, 2) in mm in the plane of the array, from its centre.
"""

import numpy as np
import numpy.typing as npt

from sabench.utils.arrays import F64


def grid(x_mm: npt.ArrayLike, y_mm: npt.ArrayLike) -> F64:
    """Pair the given offsets with each other, row by row.

    Offsets that are not uniform give a grid that is not uniform.
    """
    across, down = np.meshgrid(np.asarray(x_mm, np.float64), np.asarray(y_mm, np.float64))
    return np.column_stack([across.ravel(), down.ravel()])


def uniform_offsets(count: int, spacing_mm: float) -> F64:
    """Make `count` offsets, `spacing_mm` apart, centred on zero."""
    return np.asarray((np.arange(count) - (count - 1) / 2.0) * spacing_mm, dtype=np.float64)


def ring(count: int, radius_mm: float, start_rad: float = 0.0) -> F64:
    """Make `count` offsets uniformly around a circle.

    The first is at `start_rad` (0 is +X, towards +Y).
    """
    angle = start_rad + 2.0 * np.pi * np.arange(count) / count
    return np.asarray(radius_mm * np.column_stack([np.cos(angle), np.sin(angle)]))


def line(count: int, spacing_mm: float, angle_rad: float = 0.0) -> F64:
    """Make `count` offsets along a straight line at `angle_rad` to +X."""
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    return np.asarray(uniform_offsets(count, spacing_mm)[:, None] * direction)


def cross(arm: int, spacing_mm: float) -> F64:
    """Make a centre and four arms of `arm` offsets each: 4 arm + 1 in all."""
    steps = np.arange(1, arm + 1) * spacing_mm
    zero = np.zeros_like(steps)
    arms = ((steps, zero), (-steps, zero), (zero, steps), (zero, -steps))
    return np.vstack([np.zeros((1, 2)), *(np.column_stack(pair) for pair in arms)])
