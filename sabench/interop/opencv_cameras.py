"""Cameras in OpenCV's YAML, XML and JSON files.

A point X of the world is at R X + t before the camera, X to the right, Y down, Z forward; pixel
(0, 0) is the centre of the first pixel. Distortion has 4 to 14 coefficients: k1 k2 p1 p2 k3, the
rational k4 k5 k6, the thin prism s1 s2 s3 s4 and the tilt.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.lens import Distortion
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.interop.foreign import ForeignWorld, note
from sabench.interop.lenses import Extent, StoredCamera, camera_of_lens, camera_of_matrix, center_of
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.tables import read_text

LOST_OF_CAMERAS = ("f-numbers and focal lengths in mm", "the pixel pitch")
_SUFFIXES = (".yml", ".yaml", ".xml", ".json")
_MATRIX = ("camera_matrix", "K", "cameraMatrix", "intrinsic_matrix", "M")
_BENT = ("distortion_coefficients", "D", "distCoeffs", "dist_coeffs", "distortion")
_TURN = ("R", "rotation", "rotation_matrix", "rvec", "rotation_vector")
_MOVE = ("T", "t", "translation", "tvec", "translation_vector")
_WIDTH, _HEIGHT = ("image_width", "width", "imageWidth"), ("image_height", "height", "imageHeight")


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Read one file with one camera, or a folder with a file for each.

    Raises InputError for a missing file, one that OpenCV cannot read, or one without a lens or a
    place.
    """
    files = [path]
    if path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
    if not files:
        raise InputError(f"{path}: expected files that end in {', '.join(_SUFFIXES)}, found none")
    return [_read_camera(file, extent) for file in files]


def _read_camera(path: Path, extent: Extent) -> CameraModel:
    nodes = _read_nodes(path)
    matrix = _matrix(path, nodes, _MATRIX, (3, 3))
    turn = _matrix(path, nodes, _TURN, None)
    if turn.shape != (3, 3) and turn.size != 3:
        raise InputError(f"{path}: {_TURN[0]}: expected 9 or 3 numbers, got {turn.size}")
    rotation = turn if turn.size == 9 else rotation_matrices(turn.ravel())
    move = _matrix(path, nodes, _MOVE, None).ravel()
    if move.shape != (3,):
        raise InputError(f"{path}: {_MOVE[0]}: expected three numbers, got {move.size}")
    bent = _matrix(path, nodes, _BENT, None).ravel() if _name(nodes, _BENT) else np.zeros(5)
    if str(nodes.get("distortion_model", "")).lower() in ("fisheye", "equidistant"):
        raise InputError(f"{path}: expected Brown-Conrady's distortion, got a fisheye lens")
    rows, columns = _size(path, nodes, extent)
    pose = StoredCamera(path.stem, rows, columns, center_of(rotation, move), rotation, str(path))
    if bent.size > 5 and bent[5:].any():

        def lens(ideal: F64) -> F64:
            points, none = np.column_stack([ideal, np.ones(len(ideal))]), np.zeros(3)
            return np.asarray(cv2.projectPoints(points, none, none, matrix, bent)[0][:, 0])

        note(f"{pose.where}: its distortion has {bent.size} coefficients: the camera is `central`")
        return camera_of_lens(pose, lens, float(matrix[0, 0]))
    return camera_of_matrix(pose, matrix, Distortion(*np.resize([*bent, 0.0], 5)[:5].tolist()))


def _read_nodes(path: Path) -> dict[str, Any]:
    text = read_text(path)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {name: _value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError) as error:
        reason = str(error.__cause__ or error).strip().splitlines()
        raise InputError(
            f"{path}: expected a file of OpenCV's FileStorage, which begins with %YAML:1.0, "
            f"<?xml or a brace, got one that it cannot read: {reason[-1]}"
        ) from error


def _value(node: Any) -> Any:
    if node.isMap() and node.mat() is not None:
        return np.asarray(node.mat(), dtype=np.float64)
    if node.isSeq():
        parts = [node.at(i) for i in range(node.size())]
        return np.array([_value(part) for part in parts], dtype=object)
    if node.isInt() or node.isReal():
        return float(node.real())
    return node.string() if node.isString() else None


def _name(nodes: dict[str, Any], names: Sequence[str]) -> str | None:
    """Find the first of several names in a file, ignoring case."""
    lowered = {name.lower(): name for name in nodes}
    return next((lowered[name.lower()] for name in names if name.lower() in lowered), None)


def _matrix(
    path: Path, nodes: dict[str, Any], names: Sequence[str], shape: tuple[int, int] | None
) -> F64:
    name = _name(nodes, names)
    if name is None:
        raise InputError(
            f"{path}: expected a matrix {' or '.join(names)}, found {', '.join(nodes) or 'nothing'}"
        )
    try:
        value = np.asarray(nodes[name].tolist(), dtype=np.float64)
        if shape and value.size == shape[0] * shape[1]:
            value = value.reshape(shape)
    except (AttributeError, TypeError, ValueError):
        value = np.full(1, np.nan)
    if not np.isfinite(value).all() or shape not in (None, value.shape):
        raise InputError(
            f"{path}: {name}: expected a matrix of finite numbers, got {nodes[name]!r}"
        )
    return value


def _size(path: Path, nodes: dict[str, Any], extent: Extent) -> tuple[int, int]:
    """Read the rows and columns of the image; else take those that were given."""
    both = [_name(nodes, names) for names in (_HEIGHT, _WIDTH)]
    if None in both:
        return extent.image(str(path))
    rows, columns = (nodes[str(name)] for name in both)
    if not isinstance(rows, float) or not isinstance(columns, float) or min(rows, columns) < 1:
        raise InputError(f"{path}: expected an image's width and height, got {columns}, {rows}")
    return int(rows), int(columns)


def unfit(cameras: Sequence[CameraModel]) -> str | None:
    """Return why OpenCV's format cannot describe cameras; None if it can."""
    for camera in cameras:
        if not isinstance(camera, Camera):
            return f"{camera.name}: expected a pinhole, got {type(camera).__name__}"
        if camera.wall is not None:
            return f"{camera.name}: OpenCV has no walls, and this camera looks through one"
        if camera.distortion != Distortion() and camera.tilt_deg != (0.0, 0.0):
            return f"{camera.name}: expected no tilted sensor behind a lens with distortion"
    return None


def write_cameras(
    folder: Path, cameras: Sequence[Camera], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write a YAML file for each camera, named as the camera."""
    for given in cameras:
        camera = given.upright()
        lens, rotation = camera.distortion, np.asarray(camera.rotation)
        (column, row), focal = camera.principal_point_px, camera.focal_px
        matrix = np.array([[focal, 0.0, column], [0.0, focal, row], [0.0, 0.0, 1.0]])
        storage = cv2.FileStorage(str(folder / f"{camera.name}.yml"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", camera.columns)
        storage.write("image_height", camera.rows)
        storage.write("camera_matrix", matrix)
        bent = np.array([[lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]])
        storage.write("distortion_coefficients", bent)
        storage.write("R", rotation)
        storage.write("T", -rotation @ np.asarray(camera.center_mm)[:, None])
        storage.release()
