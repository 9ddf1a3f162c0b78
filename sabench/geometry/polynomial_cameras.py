"""Camera models without optics.

They are polynomials from positions to pixels, fitted to points of known positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import on_sensor
from sabench.geometry.refraction import Rays
from sabench.utils.arrays import F64, Bool, rows_of, triple
from sabench.utils.errors import InputError

_STEPS = 30
_SOLOFF = tuple((i, j, k) for k in range(3) for j in range(4) for i in range(4) if i + j + k <= 3)
_QUADRATIC = ((0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2))

Rows = tuple[tuple[float, ...], ...]
Smooth = Callable[[F64], F64]


@dataclass(frozen=True)
class Projective:
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
        """Intersect lines of sight through points (n, 3) with the plane at `z_mm`.

        Returns (n, 2).
        """
        way = points_mm - np.asarray(self.center_mm)
        return np.asarray(points_mm[:, :2] + way[:, :2] / way[:, 2:] * (z_mm - points_mm[:, 2:]))

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return lines of sight from the centre of projection."""
        image, matrix = rows_of(pixels, 2, "pixels"), np.asarray(self.matrix)
        inverse = np.linalg.inv(matrix[:, :3])
        directions = np.column_stack([image, np.ones(len(image))]) @ inverse.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return Rays(
            np.tile(-inverse @ matrix[:, 3], (len(image), 1)),
            directions,
            np.isfinite(directions).all(axis=1),
        )

    def contains(self, pixels: F64, margin_px: float = 0.0) -> Bool:
        """Mark pixels (n, 2) on the sensor, or at most `margin_px` outside."""
        return on_sensor(self.rows, self.columns, pixels, margin_px)


@dataclass(frozen=True)
class _Fitted:
    """Common part of the polynomial cameras.

    It holds the box of the fit, and the lines of sight, which follow from pixels alone.

    Attributes
    ----------
    middle_mm, half_mm : centre and half edges of the box; coordinates run from -1 to 1 in it.
    """

    name: str
    rows: int
    columns: int
    middle_mm: tuple[float, float, float]
    half_mm: tuple[float, float, float]

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Also returns whether each point has a pixel.
        """
        raise NotImplementedError(f"{type(self).__name__} must implement project()")

    @property
    def _ends_mm(self) -> tuple[float, float]:
        """Z of the planes that define lines of sight: the box's front and back."""
        return self.middle_mm[2] - self.half_mm[2], self.middle_mm[2] + self.half_mm[2]

    @property
    def center_mm(self) -> tuple[float, float, float]:
        """Point nearest to lines of sight of the image's corners and middle."""
        return _meeting(self)

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Find points of the plane at `z_mm` with the same pixels as points (n, 3).

        Returns (n, 2).
        """
        return _on_plane(
            lambda points: self.project(points)[0],
            self.project(points_mm)[0],
            z_mm,
            points_mm[:, :2],
            self.half_mm,
        )[:, :2]

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return lines of sight of pixels, straight through the box's front and back.

        They join the points of the two planes that a pixel sees.
        """
        return _through(
            lambda points: self.project(points)[0],
            rows_of(pixels, 2, "pixels"),
            self._ends_mm,
            self.middle_mm,
            self.half_mm,
        )

    def contains(self, pixels: F64, margin_px: float = 0.0) -> Bool:
        """Mark pixels (n, 2) on the sensor, or at most `margin_px` outside."""
        return on_sensor(self.rows, self.columns, pixels, margin_px)


@dataclass(frozen=True)
class Soloff(_Fitted):
    """Soloff's polynomial with 19 terms, cubic in X and Y and quadratic in Z.

    Column and row have one each.

    Source: Soloff, Adrian and Liu (1997), Meas. Sci. Technol. 8, 1441.

    Attributes
    ----------
    coefficients : two rows, for column and row, in the order of `_SOLOFF`: powers of X fastest,
        then Y, then Z.
    """

    coefficients: Rows

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Every finite point has a pixel, but far from the fitted box it is meaningless.
        """
        points = rows_of(points_mm, 3, "points_mm")
        pixels = _cubic((points - self.middle_mm) / self.half_mm) @ np.asarray(self.coefficients).T
        return pixels, np.isfinite(pixels).all(axis=1)


@dataclass(frozen=True)
class PlanePolynomials(_Fitted):
    """Quadratics in X and Y for several planes of one Z each.

    Lines of sight between the planes are straight. Source: J. Belden, PhD thesis, MIT 2011, section
    2.3.2.

    Attributes
    ----------
    planes_mm : Z of the planes, rising.
    coefficients : for each plane the six of the column, then the six of the row: 1, X, X^2, Y, X Y,
        Y^2.
    """

    planes_mm: tuple[float, ...]
    coefficients: Rows

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Beyond the outer planes, the last two are extrapolated.
        """
        points = rows_of(points_mm, 3, "points_mm")
        planes, table = (
            np.asarray(self.planes_mm),
            np.asarray(self.coefficients).reshape(len(self.planes_mm), 2, len(_QUADRATIC)),
        )
        left = np.clip(np.searchsorted(planes, points[:, 2]) - 1, 0, len(planes) - 2)
        share = (points[:, 2] - planes[left]) / (planes[left + 1] - planes[left])
        terms = _quadratic(((points - self.middle_mm) / self.half_mm)[:, :2])
        before, behind = (
            np.einsum("nt,nct->nc", terms, table[plane]) for plane in (left, left + 1)
        )
        pixels = before + share[:, None] * (behind - before)
        return pixels, np.isfinite(pixels).all(axis=1)


def fit_projective(name: str, rows: int, columns: int, points_mm: F64, pixels: F64) -> Projective:
    """Fit the direct linear transform of points (n, 3) and their pixels (n, 2).

    The sum of squared reprojection errors is then minimised.

    Raises
    ------
    InputError
        Fewer than 6 points, or points in one plane, which do not determine it.
    """
    (places, world), (images, image) = _normalised(points_mm), _normalised(pixels)
    full = np.column_stack([places, np.ones(len(places))])
    zero = np.zeros_like(full)
    system = np.vstack(
        [
            np.hstack([full, zero, -images[:, :1] * full]),
            np.hstack([zero, full, -images[:, 1:] * full]),
        ]
    )
    _, values, right = np.linalg.svd(system, full_matrices=False)
    if len(points_mm) < 6 or values[-2] < 1e-8 * values[0]:
        raise InputError(
            f"{name}: expected 6 points or more that are not all in one plane, got "
            f"{len(points_mm)} that do not determine a camera"
        )
    start = right[-1] * np.sign(np.median(full @ right[-1][8:]))
    matrix = np.linalg.inv(image) @ _least_squares(start, full, images).reshape(3, 4) @ world
    return Projective(name, rows, columns, _rows(matrix / np.linalg.norm(matrix[2, :3])))


def _normalised(points: F64) -> tuple[F64, F64]:
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
    for _ in range(_STEPS):
        u, v, w = (full @ entries.reshape(3, 4).T).T
        miss = (images - np.column_stack([u, v]) / w[:, None]).T.ravel()
        part, zero = full / w[:, None], np.zeros_like(full)
        slope = np.vstack(
            [
                np.hstack([part, zero, -(u / w)[:, None] * part]),
                np.hstack([zero, part, -(v / w)[:, None] * part]),
            ]
        )
        step = np.linalg.lstsq(slope, miss, rcond=1e-12)[0]
        entries = entries + step
        if np.abs(step).max() < 1e-13:
            break
    return np.asarray(entries)


def fit_soloff(name: str, rows: int, columns: int, points_mm: F64, pixels: F64) -> Soloff:
    """Fit the least-squares polynomial of points (n, 3) and their pixels (n, 2).

    Raises
    ------
    InputError
        Fewer points than its 19 terms, or points that do not determine them, e.g. on fewer than
        three planes.
    """
    middle, half = _box(points_mm)
    coefficients = _fitted(
        _cubic((points_mm - middle) / half), pixels, f"{name}: a polynomial of 19 terms"
    )
    return Soloff(name, rows, columns, triple(middle), triple(half), _rows(coefficients.T))


def fit_planes(
    name: str, rows: int, columns: int, points_mm: list[F64], pixels: list[F64]
) -> PlanePolynomials:
    """Fit quadratics to points (n, 3) and their pixels (n, 2) on several planes.

    Each plane has a least-squares fit of its own.

    Raises
    ------
    InputError
        Fewer than two planes, or a plane whose points do not determine its 6 terms.
    """
    if len(points_mm) < 2:
        raise InputError(f"{name}: expected points on two planes at least, got {len(points_mm)}")
    middle, half = _box(np.vstack(points_mm))
    depths = np.array([points[:, 2].mean() for points in points_mm])
    order = np.argsort(depths)
    table = []
    for plane in order.tolist():
        terms = _quadratic(((points_mm[plane] - middle) / half)[:, :2])
        table.append(
            _fitted(
                terms, pixels[plane], f"{name}: frame {plane}: a polynomial of 6 terms"
            ).T.ravel()
        )
    return PlanePolynomials(
        name,
        rows,
        columns,
        triple(middle),
        triple(half),
        tuple(depths[order].tolist()),
        _rows(np.stack(table)),
    )


def _cubic(unit: F64) -> F64:
    x, y, z = unit.T
    return np.stack([x**i * y**j * z**k for i, j, k in _SOLOFF], axis=1)


def _quadratic(unit: F64) -> F64:
    x, y = unit.T
    return np.stack([x**i * y**j for i, j in _QUADRATIC], axis=1)


def _fitted(terms: F64, pixels: F64, what: str) -> F64:
    solution, _, rank, _ = np.linalg.lstsq(terms, pixels, rcond=None)
    if rank < terms.shape[1]:
        raise InputError(
            f"{what}: expected points that determine it, got {len(terms)} that leave "
            f"{terms.shape[1] - rank} terms open"
        )
    return np.asarray(solution)


def _box(points_mm: F64) -> tuple[F64, F64]:
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    return (low + high) / 2.0, np.maximum((high - low) / 2.0, 1e-9)


def _through(
    project: Smooth,
    pixels: F64,
    ends: tuple[float, float],
    middle: tuple[float, float, float],
    half: tuple[float, float, float],
) -> Rays:
    """Find lines through the points of two planes that pixels (n, 2) see.

    Newton's iteration starts from the box's middle.
    """
    start = np.tile(np.asarray(middle[:2]), (len(pixels), 1))
    near, far = (_on_plane(project, pixels, z, start, half) for z in ends)
    direction = far - near
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    valid = np.isfinite(length[:, 0]) & (length[:, 0] > 0.0)
    return Rays(near, direction / np.where(valid[:, None], length, 1.0), valid)


def _on_plane(
    project: Smooth, pixels: F64, z_mm: float, start: F64, half: tuple[float, float, float]
) -> F64:
    """Find points (n, 3) of a plane by Newton's iteration from their pixels.

    The iteration starts from x, y (n, 2). Returns NaN where it does not converge.
    """
    points = np.column_stack([start, np.full(len(pixels), z_mm)])
    delta = 1e-4 * min(half[:2])
    across = delta * np.eye(3)[:2]
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            miss = pixels - project(points)
            if np.nanmax(np.abs(miss), initial=0.0) < 1e-10:
                break
            slope = np.stack(
                [
                    (project(points + step) - project(points - step)) / (2.0 * delta)
                    for step in across
                ],
                axis=-1,
            )
            determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
            points[:, 0] += (
                slope[:, 1, 1] * miss[:, 0] - slope[:, 0, 1] * miss[:, 1]
            ) / determinant
            points[:, 1] += (
                slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]
            ) / determinant
        points[~(np.abs(pixels - project(points)).max(axis=1) < 1e-6)] = np.nan
    return points


def _meeting(camera: _Fitted) -> tuple[float, float, float]:
    """Find the point nearest to a few lines of sight."""
    column, row = np.meshgrid(
        np.linspace(0.0, camera.columns - 1.0, 3), np.linspace(0.0, camera.rows - 1.0, 3)
    )
    rays = camera.back_project(np.column_stack([column.ravel(), row.ravel()]))
    direction, origin = rays.directions[rays.valid], rays.origins_mm[rays.valid]
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    return triple(
        np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, origin), rcond=None)[0]
    )


def _rows(values: F64) -> Rows:
    return tuple(tuple(row) for row in values.tolist())
