"""Cameras made of matrices, distortions and printed rotations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.central_camera import (
    CentralCamera,
    Lens,
    fit_central_camera,
    image_lattice,
    invert_lens,
)
from sabench.geometry.cylinder_wall import WallRecord
from sabench.geometry.lens import Distortion, distort
from sabench.geometry.polynomial_cameras import Soloff
from sabench.geometry.projective_camera import Projective
from sabench.geometry.refraction import Wall
from sabench.interop.foreign import note
from sabench.utils.arrays import F64, nested, triple
from sabench.utils.errors import InputError

PIXEL_MM = 0.01  # pixel size for files with focal lengths in pixels; no projection depends on it
F_NUMBER = 8.0  # no format has one
_ROUNDED = 1e-12  # change of a rotation, or of a ratio of focal lengths, due to double precision
LARGEST_CHANGE = 1e-3  # largest correction of a printed rotation's elements
_NEAREST_MM, _FARTHEST_MM = 15.0, 1e5  # distances between cameras in mm; others are other units


@dataclass(frozen=True)
class StoredCamera:
    """Name, image and place of a camera as a file gives them.

    Attributes
    ----------
    name, rows, columns : as in `Camera`.
    center_mm : (3,) pinhole.
    rotation : (3, 3) from the world to the camera's axes right, down, forward; as printed.
    wall : wall in front of the camera, or None.
    where : file and line, for sentences.
    """

    name: str
    rows: int
    columns: int
    center_mm: F64
    rotation: F64
    where: str
    wall: WallRecord | None = None


@dataclass(frozen=True)
class Extent:
    """Properties of a recording that some camera files leave out.

    Attributes
    ----------
    size : rows and columns of the images, or None.
    low_mm, high_mm : opposite corners of the measured volume, or None.
    """

    size: tuple[int, int] | None = None
    low_mm: tuple[float, float, float] | None = None
    high_mm: tuple[float, float, float] | None = None

    def image(self, where: str) -> tuple[int, int]:
        """Return the size of the images.

        Raises InputError if it is not known; `where` opens the sentence.
        """
        if self.size is None:
            raise InputError(f"{where}: it has no size of the images: give it (rows, columns)")
        return self.size


def orthonormal(matrices: F64) -> F64:
    """Find the orthonormal matrices nearest to others (..., 3, 3).

    In the Frobenius norm they come from the singular value decomposition (Horn, Hilden and
    Negahdaripour, J. Opt. Soc. Am. A 5 (1988) 1127).
    """
    left, _, right = np.linalg.svd(matrices)
    return np.asarray(left @ right)


def nearest_rotation(matrix: F64, where: str, focal_px: float) -> F64:
    """Find the rotation nearest to a printed matrix, and note the distance.

    Raises InputError for a matrix that is no rotation, or a left-handed one.
    """
    rotation = orthonormal(matrix)
    change = float(np.abs(rotation - matrix).max())
    if np.linalg.det(matrix) < 0.0:
        raise InputError(f"{where}: rotation: expected right-handed axes, got left-handed ones")
    if not change <= LARGEST_CHANGE:
        raise InputError(
            f"{where}: rotation: expected an orthonormal matrix, got one that differs from it by "
            f"{change:.2g}"
        )
    if change <= _ROUNDED:
        return matrix
    note(
        f"{where}: the printed rotation was made orthonormal; its elements change by up to "
        f"{change:.1e}, which moves pixels by up to {change * focal_px:.1e} px"
    )
    return rotation


def camera_of_matrix(
    pose: StoredCamera, matrix: F64, distortion: Distortion, pixel_mm: float = PIXEL_MM
) -> CameraModel:
    """Make a camera of a camera matrix (3, 3) and Brown-Conrady coefficients.

    It is a `Camera` if its pixels are square, else a `CentralCamera`.
    """
    scale = matrix / matrix[2, 2]
    focal, square = float(scale[0, 0]), abs(scale[1, 1] - scale[0, 0]) <= _ROUNDED * scale[0, 0]
    check_positive(pose.where, "focal length", focal, float(scale[1, 1]))
    if square and abs(scale[0, 1]) <= _ROUNDED * focal:
        middle = (float(scale[0, 2]), float(scale[1, 2]))
        return plain_camera(pose, focal, middle, distortion, pixel_mm)

    def lens(ideal: F64) -> F64:
        bent = distort(distortion, ideal)[0]
        return np.asarray(bent @ scale[:2, :2].T + scale[:2, 2])

    ratio = scale[1, 1] / scale[0, 0]
    note(
        f"{pose.where}: its pixels are not square (fy / fx = {ratio:.6f}): the camera is `central`"
    )
    return camera_of_lens(pose, lens, focal)


def plain_camera(
    pose: StoredCamera,
    focal_px: float,
    principal_point_px: tuple[float, float],
    distortion: Distortion,
    pixel_mm: float,
) -> Camera:
    """Make a pinhole camera; what no format has gets a usual value."""
    rotation = nearest_rotation(pose.rotation, pose.where, focal_px)
    x, y, z = (triple(row) for row in rotation)
    length = focal_px * pixel_mm
    return Camera(
        name=pose.name,
        rows=pose.rows,
        columns=pose.columns,
        center_mm=triple(pose.center_mm),
        rotation=(x, y, z),
        principal_distance_mm=length,
        pixel_mm=pixel_mm,
        principal_point_px=principal_point_px,
        distortion=distortion,
        focal_length_mm=length,
        f_number=F_NUMBER,
        wall=pose.wall,
    )


def camera_of_lens(pose: StoredCamera, lens: Lens, focal_px: float) -> CentralCamera:
    """Fit a central camera to a map from ideal coordinates to pixels."""
    pixels = image_lattice(pose.rows, pose.columns)
    middle = lens(np.zeros((1, 2)))
    ideal = invert_lens(lens, pixels, (pixels - middle) / focal_px)
    return camera_of_pairs(pose, ideal, pixels, focal_px)


def camera_of_pairs(pose: StoredCamera, ideal: F64, pixels: F64, focal_px: float) -> CentralCamera:
    """Fit a central camera to pairs of ideal coordinates and pixels (n, 2)."""
    rotation = nearest_rotation(pose.rotation, pose.where, focal_px)
    size = (pose.rows, pose.columns)
    return fit_central_camera(pose.name, size, (pose.center_mm, rotation), pose.wall, ideal, pixels)


def check_positive(where: str, what: str, *values: float) -> None:
    """Raise an InputError if a value is not a positive number."""
    if not all(0.0 < value < np.inf for value in values):
        got = ", ".join(f"{value:g}" for value in values)
        raise InputError(f"{where}: expected a positive {what}, got {got}")


def center_of(rotation: F64, translation: F64) -> F64:
    """Compute the pinhole of x_camera = R x + t, with the rotation nearest to R."""
    return np.asarray(-orthonormal(rotation).T @ translation)


def check_media(where: str, indices: Sequence[float]) -> None:
    """Warn if refractive indices, from the camera to the fluid, look exchanged.

    Light goes from air through a solid into a fluid of a lower index. They are kept: the file's
    orientations were fitted with them.
    """
    camera, fluid, solids = indices[0], indices[-1], indices[1:-1]
    exchanged = len(solids) > 0 and max(solids) < fluid
    if exchanged or camera > fluid:
        listed = ", ".join(f"{index:g}" for index in indices)
        wrong = "wall and fluid" if exchanged else "the camera's side and the fluid"
        note(
            f"{where}: the refractive indices {listed}, from the camera to the fluid, look as if "
            f"{wrong} were exchanged; they are kept, because the orientations were fitted with "
            "them"
        )


def check_unit(path: Any, cameras: Sequence[CameraModel], unit: str | None) -> None:
    """Refuse cameras with distances that suggest another unit than mm.

    Cameras of a tank are centimetres to metres apart. Nothing is checked where the user names the
    unit.
    """
    centers = np.array([camera.center_mm for camera in cameras])
    if unit is not None or len(centers) < 2:
        return
    apart = float(np.linalg.norm(np.ptp(centers, axis=0)))
    if apart >= _NEAREST_MM and apart <= _FARTHEST_MM:
        return
    guess = "metres" if apart < _NEAREST_MM else "micrometres"
    raise InputError(
        f"{path}: expected cameras that stand centimetres to metres apart, got all of them within "
        f"{apart:.3g} mm: the file seems to be in {guess}; name its unit (m, mm, um ...)"
    )


def scaled_camera(camera: CameraModel, factor: float) -> CameraModel:
    """Scale the world of a camera; the sensor keeps its size."""
    if factor == 1.0:
        return camera
    if isinstance(camera, Soloff):
        middle, half = (
            triple(factor * np.asarray(vector)) for vector in (camera.middle_mm, camera.half_mm)
        )
        return replace(camera, middle_mm=middle, half_mm=half)
    if isinstance(camera, Projective):
        scale = np.array([1.0, 1.0, 1.0, factor])
        return replace(camera, matrix=nested(np.asarray(camera.matrix) * scale))
    if not isinstance(camera, Camera | CentralCamera):
        raise InputError(f"{camera.name}: expected a unit of mm for a camera of this model")
    center = triple(np.asarray(camera.center_mm) * factor)
    return replace(camera, center_mm=center, wall=_scaled_wall(camera.wall, factor))


def _scaled_wall(wall: WallRecord | None, factor: float) -> WallRecord | None:
    """Scale a plane wall; formats in other units than mm have no other."""
    if not isinstance(wall, Wall):
        return wall
    layers = tuple(
        replace(layer, thickness_mm=layer.thickness_mm * factor) for layer in wall.layers
    )
    return replace(wall, point_mm=triple(np.asarray(wall.point_mm) * factor), layers=layers)


def choose_indices(
    path: Path, cameras: Sequence[CameraModel], points_mm: F64, pixels: F64
) -> list[CameraModel]:
    """Exchange the indices of wall and fluid if points then fit better.

    Parameters
    ----------
    points_mm : (n, 3) in the world of the files.
    pixels : (camera, n, 2); NaN where a camera does not see a point.

    Raises InputError for arrays of other shapes.
    """
    expected = (len(cameras), len(points_mm), 2)
    if np.shape(points_mm) != (len(points_mm), 3) or np.shape(pixels) != expected:
        raise InputError(
            f"{path}: points: expected (n, 3) and pixels {expected}, got {np.shape(points_mm)} and "
            f"{np.shape(pixels)}"
        )
    others = [_exchanged(camera) for camera in cameras]
    if all(other is camera for other, camera in zip(others, cameras, strict=True)):
        return list(cameras)
    as_read, exchanged = (_residual_px(group, points_mm, pixels) for group in (cameras, others))
    if exchanged < as_read:
        note(
            f"{path}: the refractive indices of wall and fluid were exchanged: the points then fit "
            f"to {exchanged:.3g} px, and as in the file to {as_read:.3g} px"
        )
        return others
    note(
        f"{path}: the points fit to {as_read:.3g} px (to {exchanged:.3g} px with the indices of "
        "wall and fluid exchanged)"
    )
    return list(cameras)


def _exchanged(camera: CameraModel) -> CameraModel:
    if not isinstance(camera, Camera | CentralCamera):
        return camera
    wall = camera.wall
    if not isinstance(wall, Wall) or len(wall.layers) != 1:
        return camera
    layer = replace(wall.layers[0], index=wall.fluid_index)
    other = replace(wall, layers=(layer,), fluid_index=wall.layers[0].index)
    return replace(camera, wall=other)


def _residual_px(cameras: Sequence[CameraModel], points_mm: F64, pixels: F64) -> float:
    """Compute the root mean square reprojection error; infinite without a point."""
    pairs = zip(cameras, pixels, strict=True)
    miss = np.concatenate([camera.project(points_mm)[0] - image for camera, image in pairs])
    finite = miss[np.isfinite(miss).all(axis=1)]
    return float(np.sqrt(np.mean(np.sum(finite**2, axis=1)))) if len(finite) else float("inf")
