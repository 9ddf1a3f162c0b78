"""Cameras as lists of points: X Y Z and the pixels x1 y1 x2 y2 ... of all.

It is the layout of the challenges on Lagrangian particle tracking. Pixel (0, 0) is the centre of
the first pixel. The reader fits a model to each camera; a camera that does not see a point has NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import rq

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.lens_distortion import Distortion
from sabench.geometry.polynomial_cameras import fit_soloff
from sabench.geometry.projective_camera import Projective, fit_projective
from sabench.interop.cameras.lenses import PIXEL_MM, Extent, Pose, plain_camera
from sabench.interop.foreign_world import ForeignWorld, note
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.tables import read_table

LOST = ("f-numbers and focal lengths", "the pixel pitch", "walls: the points show their effect")
FILE = "CalibPoints.txt"
_NODES = 15  # of the lattice along each edge of the volume
_HELD = 3  # every third point is held out of the comparison of models
_SQUARE = 1e-4  # shear and difference of focal lengths of a fit that counts as square pixels
_NO_WORSE = 1.1  # times the other's error up to which the simpler model is chosen


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Fit a pinhole or a Soloff polynomial to each camera of a point list.

    The one with the smaller error at points that were held out is taken, and its error is said.

    Raises
    ------
    InputError
        No such file, columns that are no pairs, too few points, or a missing size of the images.
    """
    file = path / FILE if path.is_dir() else path
    table = read_table(file, 5, missing=True)
    values = table.values
    if values.shape[1] % 2 == 0:
        raise InputError(
            f"{file}: expected X Y Z and two columns for each camera, got {values.shape[1]} columns"
        )
    size = extent.image(str(file))
    count = (values.shape[1] - 3) // 2
    parts = [values[:, 3 + 2 * i : 5 + 2 * i] for i in range(count)]
    return [
        fit_camera(f"{file}: camera {i}", f"camera_{i:02d}", size, values[:, :3], pixels)
        for i, pixels in enumerate(parts)
    ]


def fit_camera(
    where: str, name: str, size: tuple[int, int], points_mm: F64, pixels: F64
) -> CameraModel:
    """Fit a camera to points (n, 3) and pixels (n, 2); rows with NaN are left out."""
    seen = np.isfinite(points_mm).all(axis=1) & np.isfinite(pixels).all(axis=1)
    points, image = points_mm[seen], pixels[seen]
    held = np.arange(len(points)) % _HELD == 0
    errors = {}
    for fit in (fit_projective, fit_soloff):
        try:
            made = fit(name, *size, points[~held], image[~held])
            errors[fit] = float(
                np.sqrt(np.mean((made.project(points[held])[0] - image[held]) ** 2))
            )
        except InputError as error:
            fault = error
    if not errors:
        raise InputError(f"{where}: {fault}")
    best = min(errors.values())
    chosen = next(fit for fit, error in errors.items() if error <= _NO_WORSE * best + 1e-9)
    fitted = chosen(name, *size, points, image)
    camera = (isinstance(fitted, Projective) and _pinhole(fitted, where)) or fitted
    note(
        f"{where}: fitted {type(camera).__name__} to {len(points)} points, error of points held "
        f"out {errors[chosen]:.2g} px"
    )
    return camera


def _pinhole(camera: Projective, where: str) -> CameraModel | None:
    """Decompose a projective camera into a pinhole; None without square pixels."""
    matrix = np.asarray(camera.matrix)
    upper, turn = rq(matrix[:, :3])
    signs = np.diag(np.sign(np.diag(upper)))
    upper, turn = upper @ signs, signs @ turn
    upper = upper / upper[2, 2]
    focal = float(np.sqrt(upper[0, 0] * upper[1, 1]))
    if max(abs(upper[0, 0] - upper[1, 1]), abs(upper[0, 1])) > _SQUARE * focal:
        return None
    if np.linalg.det(turn) < 0.0:
        return None
    pose = Pose(camera.name, camera.rows, camera.columns, np.array(camera.center_mm), turn, where)
    middle = (float(upper[0, 2]), float(upper[1, 2]))
    return replace(plain_camera(pose, focal, middle, Distortion(), PIXEL_MM), name=camera.name)


def lattice(grid: Grid) -> F64:
    """Make a lattice of points (n, 3) over the volume of a grid."""
    low, voxel = np.asarray(grid.low_mm), np.asarray(grid.voxel_mm)
    high = low + voxel * (np.asarray(grid.shape[::-1]) - 1)
    axes = [np.linspace(a, b, _NODES) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def unfit(cameras: Sequence[CameraModel]) -> str | None:
    """Return None: every camera has pixels of points."""
    return None


def write_cameras(
    folder: Path, cameras: Sequence[CameraModel], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write the pixels of points (n, 3) in all cameras.

    Raises
    ------
    InputError
        No points.
    """
    if points_mm is None:
        raise InputError("lpt-challenge: expected a grid, over which the points are placed")
    columns = [points_mm, *(camera.project(points_mm)[0] for camera in cameras)]
    rows = np.hstack(columns).tolist()
    text = "".join(" ".join(repr(value) for value in row) + "\n" for row in rows)
    (folder / FILE).write_text(text, encoding="utf-8")
