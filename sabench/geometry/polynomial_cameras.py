"""Polynomial cameras: Soloff's, and quadratics on several planes.

They are models without optics, fitted to points of known positions.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import SensorCamera
from sabench.geometry.central_camera import invert_lens
from sabench.geometry.plane_polynomials import terms
from sabench.geometry.refraction import Rays
from sabench.utils.arrays import F64, Bool, Rows, nested, rows_of, triple
from sabench.utils.errors import InputError

_SOLOFF = tuple((i, j, k) for k in range(3) for j in range(4) for i in range(4) if i + j + k <= 3)


@dataclass(frozen=True)
class _Fitted(SensorCamera):
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
    def center_mm(self) -> tuple[float, float, float]:
        """Point nearest to lines of sight of the image's corners and middle."""
        column, row = np.meshgrid(
            np.linspace(0.0, self.columns - 1.0, 3), np.linspace(0.0, self.rows - 1.0, 3)
        )
        rays = self.back_project(np.column_stack([column.ravel(), row.ravel()]))
        direction, origin = rays.directions[rays.valid], rays.origins_mm[rays.valid]
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        right = np.einsum("nij,nj->i", across, origin)
        return triple(np.linalg.lstsq(across.sum(axis=0), right, rcond=None)[0])

    def carry(self, points_mm: F64, z_mm: float) -> F64:
        """Find points (n, 2) of the plane at `z_mm` with the pixels of points (n, 3)."""
        return self._on_plane(self.project(points_mm)[0], z_mm, points_mm[:, :2])[:, :2]

    def back_project(self, pixels: npt.ArrayLike) -> Rays:
        """Return lines of sight of pixels, straight through the box's front and back.

        They join the points of the two planes that a pixel sees.
        """
        image = rows_of(pixels, 2, "pixels")
        start = np.tile(np.asarray(self.middle_mm[:2]), (len(image), 1))
        middle, half = self.middle_mm[2], self.half_mm[2]
        near, far = (self._on_plane(image, z, start) for z in (middle - half, middle + half))
        direction = far - near
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        valid = np.isfinite(length[:, 0]) & (length[:, 0] > 0.0)
        return Rays(near, direction / np.where(valid[:, None], length, 1.0), valid)

    def _on_plane(self, pixels: F64, z_mm: float, start: F64) -> F64:
        """Find points (n, 3) of a plane from their pixels and a guess of x, y (n, 2).

        NaN where Newton's iteration does not converge.
        """
        deep = np.broadcast_to(z_mm, (len(pixels), 1))

        def pixels_of(plane_mm: F64) -> F64:
            return self.project(np.hstack([plane_mm, deep]))[0]

        found = invert_lens(pixels_of, pixels, start, min(self.half_mm[:2]))
        return np.hstack([found, np.where(np.isfinite(found[:, :1]), deep, np.nan)])


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

    @staticmethod
    def terms(unit: F64) -> F64:
        """Compute the 19 terms (n, 19) at coordinates (n, 3) from -1 to 1."""
        return _cubic(unit)

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
        planes = np.asarray(self.planes_mm)
        table = np.asarray(self.coefficients).reshape(len(planes), 2, -1)
        left = np.clip(np.searchsorted(planes, points[:, 2]) - 1, 0, len(planes) - 2)
        share = (points[:, 2] - planes[left]) / (planes[left + 1] - planes[left])
        powers = terms(((points - self.middle_mm) / self.half_mm)[:, :2], 2)
        before, behind = (np.einsum("nt,nct->nc", powers, table[p]) for p in (left, left + 1))
        pixels = before + share[:, None] * (behind - before)
        return pixels, np.isfinite(pixels).all(axis=1)


def fit_soloff(name: str, rows: int, columns: int, points_mm: F64, pixels: F64) -> Soloff:
    """Fit the least-squares polynomial of points (n, 3) and their pixels (n, 2).

    Raises InputError: fewer points than its 19 terms, or points that do not determine them, e.g. on
    fewer than three planes.
    """
    middle, half = _box(points_mm)
    coefficients = _fit_terms(
        _cubic((points_mm - middle) / half), pixels, f"{name}: a polynomial of 19 terms"
    )
    return Soloff(name, rows, columns, triple(middle), triple(half), nested(coefficients.T))


def fit_planes(
    name: str, rows: int, columns: int, points_mm: list[F64], pixels: list[F64]
) -> PlanePolynomials:
    """Fit quadratics to points (n, 3) and their pixels (n, 2) on several planes.

    Each plane has a least-squares fit of its own.

    Raises InputError: fewer than two planes, or a plane with points that do not determine its 6
    terms.
    """
    if len(points_mm) < 2:
        raise InputError(f"{name}: expected points on two planes at least, got {len(points_mm)}")
    middle, half = _box(np.vstack(points_mm))
    depths = np.array([points[:, 2].mean() for points in points_mm])
    order = np.argsort(depths)
    table = []
    for plane in order.tolist():
        powers = terms(((points_mm[plane] - middle) / half)[:, :2], 2)
        what = f"{name}: frame {plane}: a polynomial of 6 terms"
        table.append(_fit_terms(powers, pixels[plane], what).T.ravel())
    box, planes = (triple(middle), triple(half)), tuple(depths[order].tolist())
    return PlanePolynomials(name, rows, columns, *box, planes, nested(np.stack(table)))


def _cubic(unit: F64) -> F64:
    x, y, z = unit.T
    return np.stack([x**i * y**j * z**k for i, j, k in _SOLOFF], axis=1)


def _fit_terms(powers: F64, pixels: F64, what: str) -> F64:
    solution, _, rank, _ = np.linalg.lstsq(powers, pixels, rcond=None)
    if rank < powers.shape[1]:
        raise InputError(
            f"{what}: expected points that determine it, got {len(powers)} that leave "
            f"{powers.shape[1] - rank} terms open"
        )
    return np.asarray(solution)


def _box(points_mm: F64) -> tuple[F64, F64]:
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    return (low + high) / 2.0, np.maximum((high - low) / 2.0, 1e-9)


def fitted_box(camera: object) -> tuple[F64, F64] | None:
    """Return the corners (3,) of the box of a camera's fit; None without any."""
    if not isinstance(camera, _Fitted):
        return None
    middle, half = np.asarray(camera.middle_mm), np.asarray(camera.half_mm)
    return middle - half, middle + half
