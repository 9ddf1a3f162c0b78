"""Polynomials that replace cameras in a box: fast to evaluate, with derivatives.

They are fitted to the exact projection (`camera.project`, the reference) and differ from it
by less than `TOLERANCE_PX`; tests/unit/geometry/test_volume_polynomials.py measures the difference.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.plane_polynomials import TOLERANCE_PX
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import share_rows

_HIGHEST = 9
_FEW = 10_000  # points: fewer are projected before threads have begun


class VolumePolynomials(NamedTuple):
    """Pixels of all cameras as polynomials of x, y, z.

    These run from -1 to 1 in a box.

    Attributes
    ----------
    coefficients : (camera, terms, 2) of column and row.
    powers : (terms, 3), as `_powers` lists them: kernels rely on the order.
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

    Raises ValueError: a part of the box has no light path to a camera, or no degree is enough.
    """
    middle, half = (low_mm + high_mm) / 2.0, (high_mm - low_mm) / 2.0
    nodes = _HIGHEST + 2
    axis = np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    unit = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    pixels = _project_exactly(cameras, middle + half * unit)
    for degree in range(3, _HIGHEST + 1):
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


def points_in_mm(maps: VolumePolynomials, positions: F64) -> F64:
    """Convert positions in the box of the maps to world points (n, 3)."""
    return np.asarray(maps.middle_mm + positions * maps.half_mm)


def _project_exactly(cameras: Sequence[CameraModel], points_mm: F64) -> F64:
    """Project points (n, 3) exactly: columns and rows of all cameras, (n, 2 cameras)."""
    pixels = np.stack([camera.project(points_mm)[0] for camera in cameras], axis=1)
    if not np.isfinite(pixels).all():
        raise ValueError(
            "expected a light path from every camera to all of the volume, but some of it has none"
        )
    return pixels.reshape(len(points_mm), -1)


def _powers(degree: int) -> I64:
    """List exponents (terms, 3) of x, y and z with a sum of at most a degree."""
    every = itertools.product(range(degree + 1), repeat=3)
    return np.array([(i, j, k) for k, j, i in every if i + j + k <= degree])


@numba.njit(cache=True)
def project_point(maps: Any, camera: int, point: Any, pixel: Any, slope: Any) -> None:
    """Fill in a camera's pixel (2,) of a point (3,) and its slope (2, 3).

    The point's coordinates run from -1 to 1. By Horner's rule, one coordinate within the other.
    """
    x, y, z = point[0], point[1], point[2]
    terms = maps.coefficients[camera]
    degree, t = maps.powers[-1, 2], len(terms)
    u = v = ux = vx = uy = vy = uz = vz = 0.0
    for k in range(degree, -1, -1):
        a = b = ax = bx = ay = by = 0.0
        for j in range(degree - k, -1, -1):
            c = d = cx = dx = 0.0
            for _ in range(degree - k - j + 1):
                t -= 1
                cx, dx = cx * x + c, dx * x + d
                c, d = c * x + terms[t, 0], d * x + terms[t, 1]
            ay, by = ay * y + a, by * y + b
            a, b = a * y + c, b * y + d
            ax, bx = ax * y + cx, bx * y + dx
        uz, vz = uz * z + u, vz * z + v
        u, v = u * z + a, v * z + b
        ux, vx = ux * z + ax, vx * z + bx
        uy, vy = uy * z + ay, vy * z + by
    pixel[0], pixel[1] = u, v
    slope[0, 0], slope[0, 1], slope[0, 2] = ux, uy, uz
    slope[1, 0], slope[1, 1], slope[1, 2] = vx, vy, vz


@inner_kernel()
def project_row(
    maps: Any, camera: int, y: float, z: float, first: float, step: float, pixels: Any
) -> None:
    """Fill in a camera's pixels (2, n) of points along x.

    Parameters
    ----------
    first, step : x of the first point, and from each to the next.
    """
    terms = maps.coefficients[camera]
    degree, t = maps.powers[-1, 2], 0
    line = np.zeros((degree + 1, 2))
    by_z = 1.0
    for k in range(degree + 1):
        both = by_z
        for j in range(degree + 1 - k):
            for i in range(degree + 1 - k - j):
                line[i, 0] += both * terms[t, 0]
                line[i, 1] += both * terms[t, 1]
                t += 1
            both *= y
        by_z *= z
    for a in range(2):
        for n in range(pixels.shape[1]):
            pixels[a, n] = line[degree, a]
        for i in range(degree - 1, -1, -1):
            value = line[i, a]
            for n in range(pixels.shape[1]):
                pixels[a, n] = pixels[a, n] * (first + step * n) + value


def project_points(maps: VolumePolynomials, camera: int, points: F64) -> F64:
    """Compute a camera's pixels (n, 2) of points (n, 3) of coordinates from -1 to 1."""
    return project_with_slopes(maps, camera, points)[0]


def project_with_slopes(maps: VolumePolynomials, camera: int, points: F64) -> tuple[F64, F64]:
    """Compute a camera's pixels (n, 2) of points, and derivatives (n, 2, 3)."""
    pixels, slopes = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    points = np.ascontiguousarray(points, dtype=np.float64)

    def project(rows: slice) -> None:
        _project_each(maps, camera, points[rows], pixels[rows], slopes[rows])

    if len(points) < _FEW:
        project(slice(None))
    else:
        share_rows(project, len(points))
    return pixels, slopes


@numba.njit(cache=True, nogil=True)
def _project_each(maps: Any, camera: int, points: Any, pixels: Any, slopes: Any) -> None:
    for n in range(len(points)):
        project_point(maps, camera, points[n], pixels[n], slopes[n])
