"""Polynomial maps of planes to images.

The exact map, refraction included, needs an iteration per point, but it is smooth.

A polynomial's degree is raised until its worst error, measured at other points than it was fitted
to, is below `TOLERANCE_PX`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F64

TOLERANCE_PX = 1e-3
_DEGREES = range(2, 13)

Smooth = Callable[[F64], F64]  # values (n, m) at points (n, 2): u, v run from -1 to 1


@dataclass(frozen=True)
class PlaneMap:
    """Pixel coordinates over one plane as polynomials in u, v.

    These run from -1 to 1 across the grid's x and y.

    Attributes
    ----------
    degree : total degree.
    coefficients : (2, (degree + 1)(degree + 2) / 2) of column and row, terms ordered by the power
        of v, then of u.
    error_px : largest distance from the exact projection, measured between the nodes of the fit.
    """

    degree: int
    coefficients: F64
    error_px: float


def plane_maps(cameras: Sequence[CameraModel], grid: Grid) -> list[list[PlaneMap]]:
    """Fit maps of all planes (outer list) onto all cameras (inner list).

    They are of the lowest common degree within `TOLERANCE_PX`.

    Raises ValueError: some of a plane has no light path to a camera, or no degree is enough.
    """
    depths = grid.axes_mm[2]
    degree = max(
        lowest_degree(_plane_function(camera, grid, depths[[0, -1]])) for camera in cameras
    )
    by_camera = [_maps_of_degree(camera, grid, depths, degree) for camera in cameras]
    worst = max(part.error_px for maps in by_camera for part in maps)
    if worst > TOLERANCE_PX:
        raise ValueError(
            f"plane maps of degree {degree}: expected an error below {TOLERANCE_PX} px, got "
            f"{worst:.3g}"
        )
    return [list(plane) for plane in zip(*by_camera, strict=True)]


def fit_polynomials(function: Smooth, degree: int) -> tuple[F64, F64]:
    """Fit polynomials of a total degree to a smooth function.

    Returns coefficients (m, terms), and the largest error (m,) of each between the nodes.
    """
    nodes = np.cos(np.pi * (np.arange(degree + 3) + 0.5) / (degree + 3))
    between = np.linspace(-1.0, 1.0, 2 * degree + 5)
    samples, check = (
        np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) for axis in (nodes, between)
    )
    coefficients = np.asarray(
        np.linalg.lstsq(terms(samples, degree), function(samples), rcond=None)[0], dtype=np.float64
    )
    errors = np.abs(terms(check, degree) @ coefficients - function(check)).max(axis=0)
    return np.ascontiguousarray(coefficients.T), np.asarray(errors)


def lowest_degree(function: Smooth) -> int:
    """Find the lowest degree that fits a function to `TOLERANCE_PX` with a margin."""
    for degree in _DEGREES:
        if fit_polynomials(function, degree)[1].max() < 0.5 * TOLERANCE_PX:
            return degree
    raise ValueError(
        f"expected maps smooth enough for polynomials of degree {_DEGREES[-1]}: a camera, its "
        "wall or its distortion is too extreme"
    )


def terms(points: F64, degree: int) -> F64:
    """Compute monomials u^i v^j (n, terms) with i + j <= degree at points (n, 2).

    They are ordered by j, then i.
    """
    u, v = points[:, 0], points[:, 1]
    return np.stack([u**i * v**j for j in range(degree + 1) for i in range(degree + 1 - j)], axis=1)


def slopes(points: F64, degree: int) -> tuple[F64, F64]:
    """Compute derivatives of `terms` along u and along v."""
    u, v = points[:, 0], points[:, 1]
    pairs = [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]
    along_u = np.stack([i * u ** max(i - 1, 0) * v**j for i, j in pairs], axis=1)
    along_v = np.stack([j * u**i * v ** max(j - 1, 0) for i, j in pairs], axis=1)
    return along_u, along_v


def plane_points(grid: Grid, z_mm: float, unit: F64) -> F64:
    """Convert u, v of a plane to world points (n, 3)."""
    x, y, _ = grid.axes_mm
    ends = np.array([[x[0], y[0]], [x[-1], y[-1]]])
    return np.column_stack(
        [(ends[0] + ends[1]) / 2 + unit * (ends[1] - ends[0]) / 2, np.full(len(unit), z_mm)]
    )


def _maps_of_degree(camera: CameraModel, grid: Grid, depths: F64, degree: int) -> list[PlaneMap]:
    coefficients, errors = fit_polynomials(_plane_function(camera, grid, depths), degree)
    pairs = zip(
        coefficients.reshape(len(depths), 2, -1), errors.reshape(len(depths), 2), strict=True
    )
    return [PlaneMap(degree, part, float(np.linalg.norm(error))) for part, error in pairs]


def _plane_function(camera: CameraModel, grid: Grid, depths: F64) -> Smooth:
    """Make the function of exact pixels of points on several planes: (n, 2 planes)."""

    def pixels_of_plane(z_mm: float, unit: F64) -> F64:
        pixels, valid = camera.project(plane_points(grid, z_mm, unit))
        if not valid.all():
            raise ValueError(
                f"{camera.name}: expected a light path to every voxel, but the plane z = "
                f"{z_mm:g} mm has points without one"
            )
        return pixels

    return lambda unit: np.column_stack([pixels_of_plane(float(z), unit) for z in depths])
