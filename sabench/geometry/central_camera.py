"""Central cameras with a polynomial lens: pinholes that no `Camera` describes.

Pixels that are not square, shear, distortion about another point than the principal point, and
other models of distortion than Brown and Conrady's are all maps from ideal image coordinates to
pixels. `fit_central_camera` fits a polynomial to such a map.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera_model import Rotation, Vector, WalledPinhole
from sabench.geometry.cylinder_wall import WallRecord
from sabench.geometry.lens import NEWTON
from sabench.geometry.plane_polynomials import terms
from sabench.geometry.refraction import trace_to_points
from sabench.utils.arrays import F64, Bool, Rows, nested, rows_of, triple
from sabench.utils.errors import InputError

Lens = Callable[[F64], F64]  # pixels (n, 2) at ideal image coordinates (n, 2)
_DEGREES = range(1, 14)
_EXACT_PX = 1e-7  # residual that nobody notices
_NODES = 41  # of the fit along each side of the image
_MARGIN = 0.05  # of the image's size beyond its borders
_REACH = 1.2  # coordinates of the fitted box beyond which the polynomial is not evaluated


@dataclass(frozen=True)
class CentralCamera(WalledPinhole):
    """Pinhole with a polynomial in place of focal length and distortion.

    Attributes
    ----------
    name : used in file names.
    rows, columns : image size, px.
    center_mm : pinhole, world frame.
    rotation : 3x3, world to camera, as `Camera.rotation`.
    wall : wall that the camera looks through; None for plain air.
    middle, half : centre and half edges of the fitted box of ideal image coordinates x/z, y/z;
        the polynomial's variables run from -1 to 1 in it.
    degree : total degree of the polynomial.
    coefficients : two rows, of column and row, in the order of `plane_polynomials.terms`.

    Raises ValueError: another number of coefficients than of terms, or an empty box.
    """

    name: str
    rows: int
    columns: int
    center_mm: Vector
    rotation: Rotation
    middle: tuple[float, float]
    half: tuple[float, float]
    degree: int
    coefficients: Rows
    wall: WallRecord | None = None

    def __post_init__(self) -> None:
        """Check the sizes of the box and of the polynomial."""
        count = (self.degree + 1) * (self.degree + 2) // 2
        got = [len(row) for row in self.coefficients]
        if self.degree not in _DEGREES or got != [count, count]:
            raise ValueError(
                f"coefficients: expected twice {count} of degree {self.degree}, got {got}"
            )
        if not min(self.half) > 0.0:
            raise ValueError(f"half: expected positive lengths, got {self.half}")

    def project(self, points_mm: npt.ArrayLike) -> tuple[F64, Bool]:
        """Project world points (n, 3) to pixels (n, 2) as (column, row).

        Also returns whether each point has a pixel. Points far outside the image have none.
        """
        points = rows_of(points_mm, 3, "points_mm")
        paths = trace_to_points(self.wall, np.asarray(self.center_mm), points)
        local = paths.leaving @ np.asarray(self.rotation).T
        valid = paths.valid & (local[:, 2] > 1e-9)
        ideal = local[:, :2] / np.where(valid, local[:, 2], 1.0)[:, None]
        unit = (ideal - self.middle) / self.half
        valid &= (np.abs(unit) <= _REACH).all(axis=1)
        pixels = self._lens(np.where(valid[:, None], unit, 0.0))
        pixels[~valid] = np.nan
        return pixels, np.asarray(valid)

    def ideal(self, pixels: npt.ArrayLike) -> tuple[F64, Bool]:
        """Convert pixels (n, 2) to x/z and y/z (n, 2), from the box's middle on."""
        image = rows_of(pixels, 2, "pixels")
        unit = invert_lens(self._lens, image, np.zeros_like(image))
        valid: Bool = np.asarray(np.abs(unit).max(axis=1) <= _REACH)
        return np.asarray(self.middle) + np.where(valid[:, None], unit, 0.0) * self.half, valid

    def _lens(self, unit: F64) -> F64:
        return np.asarray(terms(unit, self.degree) @ np.asarray(self.coefficients).T)


def image_lattice(rows: int, columns: int) -> F64:
    """Make a lattice of pixels (n, 2) over an image and a margin around it."""
    column, row = (
        np.linspace(-0.5 - _MARGIN * size, size - 0.5 + _MARGIN * size, _NODES)
        for size in (columns, rows)
    )
    return np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2)


def invert_lens(lens: Lens, pixels: F64, guess: F64, scale: float = 1.0) -> F64:
    """Find ideal coordinates (n, 2) of pixels by Newton's iteration from a guess.

    `scale` is their size. NaN where it does not converge.
    """
    ideal, delta = guess.copy(), 1e-6 * scale
    with np.errstate(all="ignore"):
        for _ in range(NEWTON):
            miss = pixels - lens(ideal)
            if np.nanmax(np.abs(miss), initial=0.0) < 1e-10:
                break
            steps = delta * np.eye(2)
            across, along = ((lens(ideal + s) - lens(ideal - s)) / (2.0 * delta) for s in steps)
            determinant = across[:, 0] * along[:, 1] - along[:, 0] * across[:, 1]
            s = along[:, 1] * miss[:, 0] - along[:, 0] * miss[:, 1]
            t = across[:, 0] * miss[:, 1] - across[:, 1] * miss[:, 0]
            ideal = ideal + np.column_stack([s, t]) / determinant[:, None]
        ideal[~(np.abs(pixels - lens(ideal)).max(axis=1) < 1e-6)] = np.nan
    return ideal


def fit_central_camera(
    name: str,
    size: tuple[int, int],
    pose: tuple[npt.ArrayLike, npt.ArrayLike],
    wall: WallRecord | None,
    ideal: F64,
    pixels: F64,
) -> CentralCamera:
    """Fit the polynomial of the lowest degree that maps ideal coordinates to pixels.

    Parameters
    ----------
    size : rows and columns of the image.
    pose : pinhole (3,) in mm, and rotation (3, 3) from the world to the camera.
    ideal, pixels : (n, 2) pairs over the image; NaN where there is none.

    Raises InputError: a map that no polynomial of degree 13 fits to 1e-7 px.
    """
    finite: Bool = np.asarray(np.isfinite(np.hstack([ideal, pixels])).all(axis=1))
    if finite.sum() < 100:
        raise InputError(
            f"{name}: expected a lens that maps the image one to one, got one that maps "
            f"{finite.sum()} of {len(finite)} of its pixels"
        )
    ideal, pixels = ideal[finite], pixels[finite]
    low, high = ideal.min(axis=0), ideal.max(axis=0)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    degree, coefficients = _fit((ideal - middle) / half, pixels, name)
    center, rotation = (np.asarray(part, dtype=np.float64) for part in pose)
    x, y, z = map(triple, rotation)
    box = (tuple(middle.tolist()), tuple(half.tolist()))
    table = nested(coefficients.T)
    return CentralCamera(name, *size, triple(center), (x, y, z), *box, degree, table, wall)


def _fit(unit: F64, pixels: F64, name: str) -> tuple[int, F64]:
    """Raise the degree until the residual is below `_EXACT_PX`."""
    for degree in _DEGREES:
        columns = terms(unit, degree)
        coefficients = np.asarray(np.linalg.lstsq(columns, pixels, rcond=None)[0], dtype=np.float64)
        worst = float(np.abs(columns @ coefficients - pixels).max())
        if worst < _EXACT_PX:
            return degree, coefficients
    raise InputError(
        f"{name}: expected a lens that a polynomial of degree {_DEGREES[-1]} describes, got one "
        f"that differs by {worst:.2g} px"
    )
