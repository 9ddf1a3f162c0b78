"""Polynomials that replace cameras in a box: fast to evaluate, with derivatives.

They are fitted to the exact projection (`camera.project`, the reference), from which they differ
by less than `TOLERANCE_PX`; tests/unit/test_self_calibration.py measures the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F64, I64

TOLERANCE_PX = 1e-3
_HIGHEST = 9
_DEGREES = range(3, _HIGHEST + 1)
_NODES = 11  # of the fit along each axis


class VolumePolynomials(NamedTuple):
    """Pixels of all cameras as polynomials of x, y, z.

    These run from -1 to 1 in a box.

    Attributes
    ----------
    coefficients : (camera, terms, 2) of column and row.
    powers : (terms, 3).
    middle_mm, half_mm : (3,) centre and half edges of the box.
    """

    coefficients: F64
    powers: I64
    middle_mm: F64
    half_mm: F64


def fit_volume_polynomials(
    cameras: Sequence[CameraModel], low_mm: F64, high_mm: F64
) -> VolumePolynomials:
    """Fit polynomials of the lowest degree that serves for all cameras.

    Parameters
    ----------
    low_mm, high_mm : (3,) opposite corners of the box.

    Raises
    ------
    ValueError
        A part of the box has no light path to a camera, or no degree is enough.
    """
    middle, half = (low_mm + high_mm) / 2.0, (high_mm - low_mm) / 2.0
    axis = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    unit = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    pixels = _project_exactly(cameras, middle + half * unit)
    for degree in _DEGREES:
        powers = _powers(degree)
        terms = np.prod(unit[:, None] ** powers, axis=2)
        solution = np.linalg.lstsq(terms, pixels, rcond=None)[0]
        if np.abs(terms @ solution - pixels).max() < TOLERANCE_PX:
            by_camera = solution.reshape(len(powers), len(cameras), 2).transpose(1, 0, 2)
            coefficients = np.ascontiguousarray(by_camera, dtype=np.float64)
            return VolumePolynomials(coefficients, powers.astype(np.int64), middle, half)
    raise ValueError(
        f"expected cameras smooth enough for polynomials of degree {_HIGHEST}: "
        "one of them, its wall or its distortion is too extreme"
    )


def _project_exactly(cameras: Sequence[CameraModel], points_mm: F64) -> F64:
    """Project points (n, 3) exactly to pixels (n, 2 cameras).

    Column and row of each camera in turn.
    """
    pixels = np.stack([camera.project(points_mm)[0] for camera in cameras], axis=1)
    if not np.isfinite(pixels).all():
        raise ValueError(
            "expected a light path from every camera to all of the volume, but some of it has none"
        )
    return pixels.reshape(len(points_mm), -1)


def _powers(degree: int) -> I64:
    """List exponents (terms, 3) of x, y and z whose sum is at most a degree."""
    return np.array(
        [
            (i, j, k)
            for k in range(degree + 1)
            for j in range(degree + 1 - k)
            for i in range(degree + 1 - k - j)
        ]
    )


@numba.njit(cache=True)
def project_point(maps: Any, camera: int, point: Any, pixel: Any, slope: Any) -> None:
    """Fill in a camera's pixel (2,) of a point (3,) and its slope (2, 3).

    The point's coordinates run from -1 to 1.
    """
    x, y, z = np.ones(_HIGHEST + 1), np.ones(_HIGHEST + 1), np.ones(_HIGHEST + 1)
    for i in range(_HIGHEST):
        x[i + 1], y[i + 1], z[i + 1] = x[i] * point[0], y[i] * point[1], z[i] * point[2]
    pixel[:], slope[:] = 0.0, 0.0
    for t in range(len(maps.powers)):
        i, j, k = maps.powers[t]
        by_x = i * x[i - 1] * y[j] * z[k] if i else 0.0
        by_y = j * x[i] * y[j - 1] * z[k] if j else 0.0
        by_z = k * x[i] * y[j] * z[k - 1] if k else 0.0
        for a in range(2):
            value = maps.coefficients[camera, t, a]
            pixel[a] += value * x[i] * y[j] * z[k]
            slope[a, 0] += value * by_x
            slope[a, 1] += value * by_y
            slope[a, 2] += value * by_z


def project_points(maps: VolumePolynomials, camera: int, points: F64) -> F64:
    """Compute a camera's pixels (n, 2) of points (n, 3).

    The points' coordinates run from -1 to 1.
    """
    return np.asarray(np.prod(points[:, None] ** maps.powers, axis=2) @ maps.coefficients[camera])
