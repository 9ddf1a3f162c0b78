"""Surfaces that images are refocused on: plane, cylinder, height map.

A surface has its own frame. Its pixels lie on a regular grid of its own coordinates (u, v) in mm:
u along columns, v along rows. Its front is the side of its own -Z, which faces the cameras if it is
not rotated.
"""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from sabench.geometry.rigid_motion import Pose, rotation_matrices
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.tables import read_table
from sabench.utils.validation import Positive, Table, Vector

_MOST = 100_000_000  # pixels of a surface
_IMAGES = (".tif", ".tiff")  # files of heights at pixels; others are tables of points

Heights = Callable[[F64, F64], F64]


class Surface(Table):
    """Base of surfaces: position, rotation and distance of their pixels."""

    center_mm: Vector = Field((0.0, 0.0, 0.0), description="its own origin, in the world frame")
    turn_deg: Vector = Field(
        (0.0, 0.0, 0.0),
        description="rotation vector, world frame: its direction is the axis, its length the angle",
    )
    pixel_mm: Positive = Field(description="distance of its pixels along u and v")

    @property
    def ends_mm(self) -> tuple[F64, F64]:
        """First and last (u, v) of the surface."""
        raise NotImplementedError

    def own_points(self, u_mm: F64, v_mm: F64) -> F64:
        """Compute points (..., 3) in the surface's own frame; NaN where it has none."""
        raise NotImplementedError

    @property
    def axes_mm(self) -> tuple[F64, F64]:
        """Coordinates u of the columns and v of the rows, at least two of each.

        Raises InputError: more pixels than fit into memory.
        """
        low, high = self.ends_mm
        counts = np.maximum(np.floor((high - low) / self.pixel_mm * (1.0 + 1e-12)) + 1.0, 2.0)
        if counts.prod() > _MOST:
            raise InputError(
                f"pixel_mm: expected at most {_MOST:g} pixels on the surface, got "
                f"{counts.prod():.3g}: set a larger distance"
            )
        start = (low + high - (counts - 1.0) * self.pixel_mm) / 2.0
        u, v = (
            first + self.pixel_mm * np.arange(int(count))
            for first, count in zip(start, counts, strict=True)
        )
        return u, v

    @property
    def pose(self) -> Pose:
        """Map from the surface's own frame to the world's."""
        return Pose(rotation_matrices(np.deg2rad(self.turn_deg)), np.asarray(self.center_mm))

    def points_mm(self) -> F64:
        """Compute the world points (row, column, 3) of all pixels."""
        return self.pose(self.own_points(*np.meshgrid(*self.axes_mm)))


class Plane(Surface):
    """Plane: the points (u, v, 0) of its own frame."""

    size_mm: tuple[Positive, Positive] = Field(description="extent along u and v")

    @property
    def ends_mm(self) -> tuple[F64, F64]:
        """Ends at half the size on either side of the origin."""
        half = np.asarray(self.size_mm) / 2.0
        return -half, half

    def own_points(self, u_mm: F64, v_mm: F64) -> F64:
        """Compute points (..., 3) in the plane's own frame."""
        return np.stack([u_mm, v_mm, np.zeros_like(u_mm)], axis=-1)


class Cylinder(Plane):
    """Cylinder through its own origin, around an axis along its Y: u is arc length."""

    radius_mm: float = Field(
        description="positive: the axis lies behind the surface, which is convex to the cameras; "
        "negative: before it"
    )

    def own_points(self, u_mm: F64, v_mm: F64) -> F64:
        """Bend a plane: (r sin u/r, v, r (1 - cos u/r))."""
        return bend(super().own_points(u_mm, v_mm), self.radius_mm)


class HeightMap(Surface):
    """Height map: the points (u, v, height) of its own frame, read from a file."""

    file: Path = Field(
        description="text table of points x, y, height in mm, or a TIFF of heights in mm at pixels"
    )
    spacing_mm: Positive | None = Field(
        None, description="distance of the pixels of a TIFF, whose middle is the origin"
    )

    @property
    def ends_mm(self) -> tuple[F64, F64]:
        """Ends of the file's points."""
        return self._read[0], self._read[1]

    def own_points(self, u_mm: F64, v_mm: F64) -> F64:
        """Interpolate the heights linearly; NaN between points where there are none."""
        return np.stack([u_mm, v_mm, self._read[2](u_mm, v_mm)], axis=-1)

    @cached_property
    def _read(self) -> tuple[F64, F64, Heights]:
        if self.file.suffix.lower() not in _IMAGES:
            return _read_points(self.file)
        if self.spacing_mm is None:
            raise InputError("spacing_mm: expected the distance of the TIFF's pixels, got none")
        return _read_heights(self.file, self.spacing_mm)


SURFACES: dict[str, type[Surface]] = {"plane": Plane, "cylinder": Cylinder, "height_map": HeightMap}


def bend(points_mm: F64, radius_mm: float) -> F64:
    """Bend points (..., 3) about an axis along Y at Z = radius: X becomes arc length.

    Points at Z = 0 come to lie on the cylinder of that radius. The form is exact for radii of any
    size, up to the plane: both sines come without a difference of large numbers.

    Raises InputError: points that would be wrapped around the axis more than once.
    """
    x, y, z = np.moveaxis(np.asarray(points_mm, dtype=np.float64), -1, 0)
    least = float(np.abs(x).max(initial=0.0)) / np.pi
    if abs(radius_mm) < least or not radius_mm:
        raise InputError(
            f"radius_mm: expected at least {least:.4g} mm for a width of {2 * np.pi * least:.4g} "
            f"mm, either positive or negative, got {radius_mm:g}"
        )
    angle = x / radius_mm
    sagitta = 0.5 * x * angle * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.stack(
        [x * np.sinc(angle / np.pi) - z * np.sin(angle), y, sagitta + z * np.cos(angle)], axis=-1
    )


def normals_of(points_mm: F64) -> F64:
    """Compute unit normals (row, column, 3) of a surface's points.

    They point away from its front. They are cross products of central differences; NaN where a
    neighbour has no point.
    """
    along, down = np.gradient(points_mm, axis=1), np.gradient(points_mm, axis=0)
    normals = np.cross(along, down)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _read_points(path: Path) -> tuple[F64, F64, Heights]:
    """Read scattered or gridded points; heights are linear on Delaunay's triangles."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError

    points = read_table(path, 3).values[:, :3]
    try:
        inner = LinearNDInterpolator(points[:, :2], points[:, 2])
    except (QhullError, ValueError) as error:
        raise InputError(
            f"{path}: expected three or more points that span an area in their first two "
            f"columns, got {len(points)} that do not"
        ) from error
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return low, high, lambda u, v: np.asarray(inner(u, v), dtype=np.float64)


def _read_heights(path: Path, spacing_mm: float) -> tuple[F64, F64, Heights]:
    """Read heights at pixels, rows along v and columns along u; linear between."""
    import tifffile
    from scipy.ndimage import map_coordinates

    if not path.is_file():
        raise InputError(f"{path}: expected a file of heights, found none")
    try:
        heights: Any = tifffile.imread(path)
    except Exception as error:  # tifffile raises what its parsers raise
        raise InputError(
            f"{path}: expected a TIFF of heights, got {type(error).__name__}: {error}"
        ) from error
    if heights.ndim != 2 or min(heights.shape) < 2 or heights.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: expected one image of numbers, 2 x 2 or larger, got {heights.dtype} of shape "
            f"{heights.shape}"
        )
    heights = np.asarray(heights, dtype=np.float64)
    half = spacing_mm * (np.array(heights.shape[::-1]) - 1.0) / 2.0

    def interpolate(u: F64, v: F64) -> F64:
        at = [(v + half[1]) / spacing_mm, (u + half[0]) / spacing_mm]
        return np.asarray(map_coordinates(heights, at, order=1, mode="nearest"))

    return -half, half, interpolate
