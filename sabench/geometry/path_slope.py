"""Slope of a light path through parallel plane layers, by its lateral distance.

Light between a point of the camera's medium and a point of the fluid stays in the plane that holds
both and the wall normal, so the path has one unknown. sabench takes t = tan of the ray's angle in
the RAREST medium of the stack: every other medium then has a relative index r >= 1 and adds d t /
sqrt(r^2 + (r^2 - 1) t^2) to the lateral distance, which increases and is concave in t and has no
pole, for any order of indices. Newton's iteration on an increasing concave function climbs to the
root from the left without overshooting; the bracket [t_low, R / d_rarest] guards it against
rounding all the same. (The thesis solves the same path for two unknowns per layer pair, equations
4.14 and 4.15.)
"""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64

_HALLEY, _MAX_STEPS = 4, 100


def solve_slope(indices: F64, depths_mm: list[F64 | float], radius_mm: F64) -> tuple[F64, F64]:
    """Solve for the tangent t of the angle in the rarest medium of paths.

    The paths have a given lateral distance.

    Parameters
    ----------
    indices : (m,) refractive indices.
    depths_mm : for each medium the distance that the path crosses along the normal; scalars or
        arrays (n,), positive or zero.
    radius_mm : (n,) lateral distance between the ends of the path.

    Returns
    -------
    slope : (n,) t >= 0.
    residual_mm : (n,) lateral distance of the traced path minus `radius_mm`.
    """
    relative = indices / indices.min()
    quick = _halley(relative, depths_mm, radius_mm)
    if quick is not None:
        return quick
    rare = np.asarray(sum(depth for depth, r in zip(depths_mm, relative, strict=True) if r == 1.0))
    # an upper bound: the rarest medium alone cannot bridge more than R
    upper = radius_mm / np.maximum(rare, 1e-300)
    slowness = sum(depth / r for depth, r in zip(depths_mm, relative, strict=True))
    slope = low = radius_mm / np.asarray(slowness)  # paraxial root
    value, gradient = _lateral(relative, depths_mm, slope)
    for _ in range(_MAX_STEPS):
        low = np.where(value <= radius_mm, np.maximum(low, slope), low)
        upper = np.where(value >= radius_mm, np.minimum(upper, slope), upper)
        step = slope + (radius_mm - value) / gradient
        better = np.where((step >= low) & (step <= upper), step, 0.5 * (low + upper))
        moved = np.abs(better - slope)
        slope = better
        value, gradient = _lateral(relative, depths_mm, slope)
        if np.all(
            (moved <= 2e-16 * slope) | (np.abs(value - radius_mm) <= 2e-13 + 5e-16 * radius_mm)
        ):
            break
    return slope, value - radius_mm


def _halley(relative: F64, depths_mm: list[F64 | float], radius_mm: F64) -> tuple[F64, F64] | None:
    """Solve by a few of Halley's steps, without a bracket.

    Each step triples the right digits. Returns None where one path has not converged.
    """
    slope = _start(relative, depths_mm, radius_mm)
    for _ in range(_HALLEY):
        value, gradient, curvature = _lateral_distance(relative, depths_mm, slope)
        miss = radius_mm - value
        step = 2.0 * miss * gradient / (2.0 * gradient * gradient - 3.0 * miss * curvature * slope)
        slope = slope + step
        if np.all(np.abs(step) <= 1e-5 * slope):
            value, _ = _lateral(relative, depths_mm, slope)
            left = value - radius_mm
            return (slope, left) if np.all(np.abs(left) <= 2e-13 + 5e-16 * radius_mm) else None
    return None


def _start(relative: F64, depths_mm: list[F64 | float], radius_mm: F64) -> F64:
    """Compute a first tangent.

    It is right to the third power for steep paths, and in the limit for flat ones, where the rarest
    medium dominates.
    """
    paraxial, rare, curvature = (np.zeros(np.shape(radius_mm)) for _ in range(3))
    for depth, r in zip(depths_mm, relative, strict=True):
        paraxial += depth / r
        if r == 1.0:
            rare += depth
        else:
            curvature += depth * (0.5 * (r * r - 1.0) / r**3)
    slope = radius_mm / paraxial
    square = slope * slope * curvature
    excess = paraxial - rare
    return np.asarray(
        slope * (1.0 + square * excess / (paraxial * excess + rare * square + 1e-300))
    )


def _lateral_distance(
    relative: F64, depths_mm: list[F64 | float], slope: F64
) -> tuple[F64, F64, F64]:
    """Compute lateral distance of a path with slope t, and derivatives.

    The slope is that in the rarest medium. The derivatives are the first, and the second over -3 t.
    """
    square = slope * slope
    value, gradient, curvature = np.zeros_like(slope), np.zeros_like(slope), np.zeros_like(slope)
    for depth, r in zip(depths_mm, relative, strict=True):
        if r == 1.0:
            value += depth
            gradient += depth
            continue
        inverse_square = 1.0 / (r * r + (r * r - 1.0) * square)
        part = depth * np.sqrt(inverse_square)
        value += part
        part *= inverse_square
        part *= r * r
        gradient += part
        part *= inverse_square
        part *= r * r - 1.0
        curvature += part
    return value * slope, gradient, curvature


def _lateral(relative: F64, depths_mm: list[F64 | float], slope: F64) -> tuple[F64, F64]:
    """Compute the lateral distance of a path and its derivative.

    The slope in the rarest medium is t.
    """
    square = slope * slope
    value, gradient = np.zeros_like(slope), np.zeros_like(slope)
    for depth, r in zip(depths_mm, relative, strict=True):
        if r == 1.0:
            value += depth * slope
            gradient += depth
            continue
        inverse = 1.0 / np.sqrt(r * r + (r * r - 1.0) * square)
        part = depth * inverse
        value += part * slope
        gradient += (r * r) * part * inverse * inverse
    return value, gradient


def angle_in(indices: F64, medium: int, slope: F64) -> tuple[F64, F64]:
    """Compute sine and cosine of the path's angle in one medium.

    The tangent in the rarest medium is given.
    """
    r, square = indices[medium] / indices.min(), slope * slope
    scale = 1.0 / np.sqrt(1.0 + square)
    if r == 1.0:
        return slope * scale, scale
    scale /= r
    square *= r * r - 1.0
    square += r * r
    return slope * scale, np.sqrt(square, out=square) * scale
