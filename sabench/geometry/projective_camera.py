"""Projective camera: the direct linear transform, fitted to known points."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import SensorCamera
from sabench.geometry.lens import NEWTON
from sabench.geometry.refraction import Rays
from sabench.utils.arrays import F64, Bool, Rows, nested, rows_of, triple
from sabench.utils.errors import InputError


@dataclass(frozen=True)
class Projective(SensorCamera):
    """Linear map of homogeneous coordinates, with 11 free parameters.

    It is a pinhole with any pixels, in a single medium.

    Source: R. Hartley and A. Zisserman, Multiple View Geometry, chapters 6 and 7.

    Attributes
    ----------
    matrix : (3, 4) as nested tuples, P of (column, row, 1) w = P (X, Y, Z, 1); w is positive in
        front of the camera.
    """

    name: str
    rows: int
    columns: int
    matrix: Rows

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Points behind the camera are not `valid`.
        """
        points, matrix = rows_of(points_mm, 3, "points_mm"), np.asarray(self.matrix)
        image = points @ matrix[:, :3].T + matrix[:, 3]
        valid = np.asarray(image[:, 2] > 0.0)
        pixels = image[:, :2] / np.where(valid, image[:, 2], np.nan)[:, None]
        return pixels, valid

    @property
    def center_mm(self) -> tuple[float, float, float]:
        """The centre of projection."""
        matrix = np.asarray(self.matrix)
        return triple(-np.linalg.solve(matrix[:, :3], matrix[:, 3]))

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Intersect lines of sight through points (n, 3) with z = `z_mm`: (n, 2)."""
        ray = points_mm - np.asarray(self.center_mm)
        return np.asarray(points_mm[:, :2] + ray[:, :2] / ray[:, 2:] * (z_mm - points_mm[:, 2:]))

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return lines of sight from the centre of projection."""
        image, matrix = rows_of(pixels, 2, "pixels"), np.asarray(self.matrix)
        inverse = np.linalg.inv(matrix[:, :3])
        directions = np.column_stack([image, np.ones(len(image))]) @ inverse.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.tile(-inverse @ matrix[:, 3], (len(image), 1))
        return Rays(origins, directions, np.isfinite(directions).all(axis=1))


def fit_projective(name: str, rows: int, columns: int, points_mm: F64, pixels: F64) -> Projective:
    """Fit the direct linear transform of points (n, 3) and their pixels (n, 2).

    The sum of squared reprojection errors is then minimised.

    Raises InputError: fewer than 6 points, or points in one plane, which do not determine it.
    """
    (positions, world), (images, image) = _normalise(points_mm), _normalise(pixels)
    full = np.column_stack([positions, np.ones(len(positions))])
    zero = np.zeros_like(full)
    columns_part = np.hstack([full, zero, -images[:, :1] * full])
    system = np.vstack([columns_part, np.hstack([zero, full, -images[:, 1:] * full])])
    _, values, right = np.linalg.svd(system, full_matrices=False)
    if len(points_mm) < 6 or values[-2] < 1e-8 * values[0]:
        raise InputError(
            f"{name}: expected 6 points or more that are not all in one plane, got "
            f"{len(points_mm)} that do not determine a camera"
        )
    start = right[-1] * np.sign(np.median(full @ right[-1][8:]))
    matrix = np.linalg.inv(image) @ _least_squares(start, full, images).reshape(3, 4) @ world
    return Projective(name, rows, columns, nested(matrix / np.linalg.norm(matrix[2, :3])))


def _normalise(points: F64) -> tuple[F64, F64]:
    """Move and scale points to a root mean square of 1 per coordinate.

    Also returns the homogeneous matrix that does it.
    """
    middle, scale = points.mean(axis=0), 1.0 / max(float(points.std()), 1e-300)
    matrix = np.diag([*[scale] * points.shape[1], 1.0])
    matrix[:-1, -1] = -scale * middle
    return (points - middle) * scale, matrix


def _least_squares(start: F64, full: F64, images: F64) -> F64:
    """Refine the linear solution by Gauss and Newton's steps.

    The pseudo-inverse leaves the matrix's scale unchanged.
    """
    entries = start / np.linalg.norm(start)
    for _ in range(NEWTON):
        u, v, w = (full @ entries.reshape(3, 4).T).T
        miss = (images - np.column_stack([u, v]) / w[:, None]).T.ravel()
        part, zero = full / w[:, None], np.zeros_like(full)
        columns_part = np.hstack([part, zero, -(u / w)[:, None] * part])
        slope = np.vstack([columns_part, np.hstack([zero, part, -(v / w)[:, None] * part])])
        step = np.linalg.lstsq(slope, miss, rcond=1e-12)[0]
        entries = entries + step
        if np.abs(step).max() < 1e-13:
            break
    return np.asarray(entries)
