"""Plane sweep: every voxel of every plane looked up in every camera, refraction included. One Dr.Jit source for CPU and GPU.

The exact map of a plane onto an image needs an iteration per voxel, but it is smooth: a bivariate polynomial through exact projections
replaces it. Its degree is raised until its worst error, measured at other points than it was fitted to, is below `TOLERANCE_PX`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench import backend
from sabench.arrays import F32, F64
from sabench.optics.camera import Camera
from sabench.progress import track
from sabench.volume import Grid

TOLERANCE_PX = 1e-3
_DEGREES = range(2, 13)

Fold = Callable[[Any, Sequence[Any]], Any]  # (drjit, one Dr.Jit array of samples per camera) -> the plane's voxels


@dataclass(frozen=True)
class PlaneMap:
    """Pixel coordinates over one plane as polynomials in u, v, which run from -1 to 1 across the grid's x and y.

    Attributes
    ----------
    degree : total degree.
    coefficients : (2, (degree + 1)(degree + 2) / 2) of column and row, terms ordered by the power of v, then of u.
    error_px : largest distance from the exact projection, measured between the nodes of the fit.
    """

    degree: int
    coefficients: F64
    error_px: float


def plane_map(camera: Camera, grid: Grid, z_mm: float, degree: int) -> PlaneMap:
    """Fit the map of the plane at `z_mm` onto a camera's image.

    Raises
    ------
    ValueError
        Some of the plane has no light path to the camera.
    """
    nodes = np.cos(np.pi * (np.arange(degree + 3) + 0.5) / (degree + 3))
    between = np.linspace(-1.0, 1.0, 2 * degree + 5)
    fit, check = (np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2) for axis in (nodes, between))
    target = _project_plane(camera, grid, z_mm, fit)
    coefficients = np.asarray(np.linalg.lstsq(_terms(fit, degree), target, rcond=None)[0], dtype=np.float64)
    error = np.linalg.norm(_terms(check, degree) @ coefficients - _project_plane(camera, grid, z_mm, check), axis=1).max()
    return PlaneMap(degree, np.asarray(coefficients.T), float(error))


def plane_maps(cameras: Sequence[Camera], grid: Grid) -> list[list[PlaneMap]]:
    """Maps of all planes (outer list) onto all cameras (inner list), of the lowest common degree within `TOLERANCE_PX`."""
    depths = grid.axes_mm[2]
    degree = max(_degree_for(camera, grid, z) for camera in cameras for z in (depths[0], depths[-1]))
    maps = [[plane_map(camera, grid, z, degree) for camera in cameras] for z in depths]
    worst = max(part.error_px for plane in maps for part in plane)
    if worst > TOLERANCE_PX:
        raise ValueError(f"plane maps of degree {degree}: expected an error below {TOLERANCE_PX} px, got {worst:.3g}")
    return maps


def sweep(images: F32, cameras: Sequence[Camera], grid: Grid, fold: Fold) -> F32:
    """Refocus on every plane of the grid: sample all images bilinearly at each voxel and fold the samples into one value.

    Parameters
    ----------
    images : (camera, row, column).
    fold : makes the voxel's value of the cameras' samples, in Dr.Jit operations; a voxel outside an image samples 0.

    Returns
    -------
    volume : (z, y, x).
    """
    dr, types = backend.drjit()
    maps = plane_maps(cameras, grid)
    flat = [types.Float(image.ravel()) for image in images]
    height, width = grid.shape[1:]
    index = dr.arange(types.UInt32, height * width)
    row = index // width
    u, v = _unit(types.Float(index - row * width), width), _unit(types.Float(row), height)
    dr.eval(u, v)
    volume = np.empty(grid.shape, dtype=np.float32)
    for k, plane in enumerate(track(maps, f"refocus, {len(cameras)} cameras")):
        samples = [_sample(dr, types, image, camera, part, u, v) for image, camera, part in zip(flat, cameras, plane, strict=True)]
        volume[k] = np.asarray(fold(dr, samples)).reshape(height, width)
    return volume


def _unit(index: Any, count: int) -> Any:
    return index * (2.0 / max(count - 1, 1)) - (1.0 if count > 1 else 0.0)


def _sample(dr: Any, types: Any, image: Any, camera: Camera, part: PlaneMap, u: Any, v: Any) -> Any:
    """Bilinear samples of one image at the mapped positions; zero outside the pixel centres' hull."""
    column, row = (_horner(dr, types, c, part.degree, u, v) for c in part.coefficients)
    left, top = dr.floor(column), dr.floor(row)
    inside = (column >= 0.0) & (row >= 0.0) & (column <= camera.columns - 1.0) & (row <= camera.rows - 1.0)
    left_index = dr.minimum(types.Int32(left), camera.columns - 2)
    top_index = dr.minimum(types.Int32(top), camera.rows - 2)
    right_share = column - types.Float(left_index)
    bottom_share = row - types.Float(top_index)
    corner = types.UInt32(top_index * camera.columns + left_index)
    values = [dr.gather(types.Float, image, corner + offset, inside) for offset in (0, 1, camera.columns, camera.columns + 1)]
    upper = dr.fma(right_share, values[1] - values[0], values[0])
    lower = dr.fma(right_share, values[3] - values[2], values[2])
    return dr.fma(bottom_share, lower - upper, upper)


def _horner(dr: Any, types: Any, coefficients: F64, degree: int, u: Any, v: Any) -> Any:
    """A bivariate polynomial of a total degree; coefficients are opaque, so that all planes and cameras share one kernel."""
    result, start = None, len(coefficients)
    for power_v in range(degree, -1, -1):
        count = degree - power_v + 1
        start -= count
        line = None
        for c in reversed(coefficients[start : start + count]):
            value = dr.opaque(types.Float, float(c))
            line = value if line is None else dr.fma(line, u, value)
        result = line if result is None else dr.fma(result, v, line)
    return result


def _terms(points: F64, degree: int) -> F64:
    """Monomials u^i v^j with i + j <= degree at points (n, 2), ordered by j, then i."""
    u, v = points[:, 0], points[:, 1]
    return np.stack([u**i * v**j for j in range(degree + 1) for i in range(degree + 1 - j)], axis=1)


def _degree_for(camera: Camera, grid: Grid, z_mm: float) -> int:
    for degree in _DEGREES:
        if plane_map(camera, grid, z_mm, degree).error_px < 0.5 * TOLERANCE_PX:
            return degree
    raise ValueError(f"{camera.name}: expected a plane map smooth enough for degree {_DEGREES[-1]}, at z = {z_mm:g} mm it is not")


def _project_plane(camera: Camera, grid: Grid, z_mm: float, unit: F64) -> F64:
    """Exact pixels (n, 2) of points of a plane given in u, v."""
    x, y, _ = grid.axes_mm
    ends = np.array([[x[0], y[0]], [x[-1], y[-1]]])
    points = np.column_stack([(ends[0] + ends[1]) / 2 + unit * (ends[1] - ends[0]) / 2, np.full(len(unit), z_mm)])
    pixels, valid = camera.project(points)
    if not valid.all():
        raise ValueError(f"{camera.name}: expected a light path to every voxel, but the plane z = {z_mm:g} mm has points without one")
    return pixels
