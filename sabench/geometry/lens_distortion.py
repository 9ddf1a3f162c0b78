"""Radial and tangential distortion of lenses, by Brown and Conrady's model."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64, Bool

_UNDISTORT_STEPS = 20


@dataclass(frozen=True)
class Distortion:
    """Brown-Conrady coefficients of distortion.

    They are dimensionless and act on ideal image coordinates x/z, y/z. All zero means none.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0


@functools.cache
def _fold_square(lens: Distortion) -> float:
    """Find the squared ideal radius at which the radial part stops growing.

    Beyond it, two points share a pixel.
    """
    roots = np.roots([7.0 * lens.k3, 5.0 * lens.k2, 3.0 * lens.k1, 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else float("inf")


def distort(lens: Distortion, ideal: F64) -> tuple[F64, Bool, tuple[F64, F64, F64]]:
    """Compute distorted image coordinates, validity and Jacobian.

    Valid is where the map is one to one: inside the radial fold, with a positive determinant.

    The Jacobian is symmetric: (du/dx, du/dy, dv/dy).
    """
    x, y = ideal[:, 0], ideal[:, 1]
    s = x * x + y * y
    radial = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    slope = lens.k1 + s * (2.0 * lens.k2 + 3.0 * lens.k3 * s)
    u = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (s + 2.0 * x * x)
    v = y * radial + lens.p1 * (s + 2.0 * y * y) + 2.0 * lens.p2 * x * y
    ux = radial + 2.0 * x * x * slope + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x
    uy = 2.0 * x * y * slope + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y
    vy = radial + 2.0 * y * y * slope + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x
    one_to_one = (ux * vy - uy * uy > 0.0) & (s < _fold_square(lens))
    return np.column_stack([u, v]), np.asarray(one_to_one), (ux, uy, vy)


def undistort(lens: Distortion, distorted: F64) -> tuple[F64, Bool]:
    """Invert `distort` by Newton's iteration with the exact residual as its test."""
    if lens == Distortion():
        return distorted, np.asarray(np.isfinite(distorted).all(axis=1))
    ideal, residual = distorted.copy(), np.zeros_like(distorted)
    with np.errstate(all="ignore"):
        for _ in range(_UNDISTORT_STEPS):
            image, _, (ux, uy, vy) = distort(lens, ideal)
            residual = distorted - image
            if np.all(np.abs(residual) < 1e-15):
                break
            a, b = residual.T
            ideal = (
                ideal
                + np.column_stack([vy * a - uy * b, ux * b - uy * a]) / (ux * vy - uy * uy)[:, None]
            )
        valid = (np.abs(residual).max(axis=1) < 1e-12) & distort(lens, ideal)[1]
    return ideal, np.asarray(valid)
