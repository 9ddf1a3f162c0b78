"""Folder of a calibration: its configuration, and points or images of a target.

docs/using/calibrating.md describes it.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from sabench.algorithms.calibration.target_detection import detect
from sabench.api import CalibrationCase
from sabench.api.truth import Target
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.lens_distortion import Distortion
from sabench.images.photographs import read_photographs
from sabench.scenes.tank import build_walls, wall_towards
from sabench.scenes.wall import CylinderSpec, wall_tables
from sabench.tasks.calibration_configuration import Configuration
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar
from sabench.utils.validation import printable, validate

CONFIGURATION, IMAGES, POINTS = "calibration.toml", "images", "points.csv"
_COLUMNS = ["camera", "frame", "point", "column", "row"]
_FARTHEST_MM = 1e6  # a kilometre
_FARTHEST_PX = 1e6  # of a point from the image's corner
_MOST_PIXELS = 20_000_000  # pixels of points in all frames and cameras
_SUFFIXES = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")


def read_case(folder: Path) -> CalibrationCase:
    """Read a folder's calibration: its points.csv, or else points of its images."""
    path = folder / CONFIGURATION
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: expected the description of a calibration, found none") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a TOML file, got {error}") from error
    configuration = validate(Configuration, values, str(path))
    _check_lengths(configuration, str(path))
    target = Target(**configuration.target.model_dump())
    cameras = _cameras(configuration, str(path))
    plain = target.points_mm + np.asarray(configuration.target_mm)
    pixels = (
        _read_points(folder / POINTS, target, cameras)
        if (folder / POINTS).is_file()
        else _read_images(folder / IMAGES, target, cameras, plain)
    )
    initial = np.tile(plain, (pixels.shape[1], 1, 1))
    return CalibrationCase(
        target,
        pixels,
        cameras,
        initial,
        *_known_positions(configuration, initial.shape, str(path)),
        configuration.unknown,
    )


def _check_lengths(configuration: Configuration, source: str) -> None:
    """Check that lengths and coordinates are such as a laboratory has."""
    target, array = configuration.target, configuration.array
    given = {
        "target": (target.pitch_mm, target.mark_mm),
        "target_mm": configuration.target_mm,
        "array": (array.pixel_mm, array.focal_length_mm, array.principal_distance_mm or 0.0),
    }
    for number, camera in enumerate(configuration.cameras):
        given[f"cameras.{number}"] = (*camera.center_mm, *camera.aim_mm)
    for number, point in enumerate(configuration.known):
        given[f"known.{number}"] = (point.x_mm or 0.0, point.y_mm or 0.0, point.z_mm or 0.0)
    for wall in wall_tables(configuration.wall):
        place = wall.axis_point_mm if isinstance(wall, CylinderSpec) else wall.point_mm
        given["wall"] = (*given.get("wall", ()), *place)
    for key, values in given.items():
        largest = max(map(abs, values))
        if largest > _FARTHEST_MM:
            raise InputError(
                f"{source}: {key}: expected at most {_FARTHEST_MM:g} mm, got {largest:g}"
            )


def _cameras(configuration: Configuration, source: str) -> tuple[Camera, ...]:
    walls = build_walls(configuration.wall)
    shared, cameras = configuration.array, []
    names = [spec.name for spec in configuration.cameras]
    if len(set(names)) != len(names):
        raise InputError(f"{source}: cameras: expected different names, got {names}")
    for spec in configuration.cameras:
        focal_length_mm = spec.focal_length_mm or shared.focal_length_mm
        distance_mm = spec.principal_distance_mm or shared.principal_distance_mm
        camera = Camera(
            name=spec.name,
            rows=shared.rows,
            columns=shared.columns,
            center_mm=spec.center_mm,
            rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),
            principal_distance_mm=distance_mm or focal_length_mm,
            pixel_mm=spec.pixel_mm or shared.pixel_mm,
            principal_point_px=spec.principal_point_px
            or ((shared.columns - 1) / 2.0, (shared.rows - 1) / 2.0),
            distortion=Distortion(**spec.distortion.model_dump()),
            focal_length_mm=focal_length_mm,
            f_number=8.0,
            tilt_deg=spec.tilt_deg,
            wall=wall_towards(walls, np.asarray(spec.center_mm), np.asarray(spec.aim_mm)),
        )
        try:
            cameras.append(aim(camera, spec.aim_mm))
        except ValueError as error:
            raise InputError(
                f"{source}: {error}: is the wall behind the camera, or the target in front of the "
                "wall?"
            ) from error
    return tuple(cameras)


def _known_positions(
    configuration: Configuration, shape: tuple[int, ...], source: str
) -> tuple[F64, F64]:
    positions, sigmas = np.full(shape, np.nan), np.full(shape, np.nan)
    for number, point in enumerate(configuration.known):
        if point.frame >= shape[0] or point.point >= shape[1]:
            raise InputError(
                f"{source}: known.{number}: expected one of {shape[0]} frames and of {shape[1]} "
                f"points, got {point.frame} and {point.point}"
            )
        for axis, value in enumerate((point.x_mm, point.y_mm, point.z_mm)):
            if value is not None:
                (
                    positions[point.frame, point.point, axis],
                    sigmas[point.frame, point.point, axis],
                ) = (
                    value,
                    point.sigma_mm,
                )
    return positions, sigmas


def _read_points(path: Path, target: Target, cameras: tuple[Camera, ...]) -> F64:
    """Read points.csv, which has the first line `camera,frame,point,column,row`.

    Every further line is a point that was found.
    """
    numbers, rows = {camera.name: i for i, camera in enumerate(cameras)}, list(_lines(path))
    frames = 1 + max((row[1] for row in rows), default=-1)
    count = len(target.points_mm)
    most = min(len(rows), _MOST_PIXELS // (len(cameras) * count))
    if frames > most:
        raise InputError(
            f"{path}: expected frames counted from 0 and at most {most}, for {len(rows)} points "
            f"found, got frame {frames - 1}"
        )
    pixels = np.full((len(cameras), max(frames, 1), count, 2), np.nan)
    for camera, frame, point, column, row in rows:
        if camera not in numbers or not 0 <= point < count or frame < 0:
            raise InputError(
                f"{path}: expected cameras {', '.join(numbers)} and points 0 to {count - 1}, got "
                f"{camera}, frame {frame}, point {point}"
            )
        if np.isfinite(pixels[numbers[camera], frame, point, 0]):
            raise InputError(
                f"{path}: {camera}, frame {frame}: expected point {point} once, got it twice"
            )
        pixels[numbers[camera], frame, point] = column, row
    return pixels


def _lines(path: Path) -> Iterator[tuple[str, int, int, float, float]]:
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            if reader.fieldnames != _COLUMNS:
                raise InputError(
                    f"{path}: expected the first line {','.join(_COLUMNS)}, got "
                    f"{printable(','.join(reader.fieldnames or ()))}"
                )
            for number, line in enumerate(reader, 2):
                yield _point(path, number, line)
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected a CSV file in UTF-8, got {error}") from error


def _point(path: Path, number: int, line: dict[str, str]) -> tuple[str, int, int, float, float]:
    """Read a line: camera, frame and number of a point, and its pixel."""
    where = f"{path}: line {number}"
    try:
        frame, point = int(line["frame"]), int(line["point"])
        column, row = float(line["column"]), float(line["row"])
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{where}: expected a name, two whole numbers and two numbers, got {error}"
        ) from error
    if not (abs(column) <= _FARTHEST_PX and abs(row) <= _FARTHEST_PX):
        raise InputError(
            f"{where}: expected pixels of -{_FARTHEST_PX:g} to {_FARTHEST_PX:g}, got {column}, "
            f"{row}"
        )
    return line["camera"], frame, point, column, row


def _read_images(folder: Path, target: Target, cameras: tuple[Camera, ...], plain: F64) -> F64:
    """Detect the target in images/FRAME/CAMERA.tif (or png, bmp, jpg).

    Frames are in the order of their folders' names.
    """
    frames = (
        sorted(entry for entry in folder.iterdir() if entry.is_dir()) if folder.is_dir() else []
    )
    if not frames:
        raise InputError(
            f"{folder}: expected folders with an image of each camera, or a {POINTS} next to it, "
            "found neither"
        )
    pixels = np.full((len(cameras), len(frames), len(target.points_mm), 2), np.nan)
    shape = (cameras[0].rows, cameras[0].columns)
    for k in progress_bar(range(len(frames)), "find the target"):
        paths = {c: path for c, camera in enumerate(cameras) if (path := _find(frames[k], camera))}
        for c, image in zip(paths, read_photographs([*paths.values()], shape), strict=True):
            pixels[c, k] = detect(image, target, cameras[c].project(plain)[0])
    return pixels


def _find(frame: Path, camera: Camera) -> Path | None:
    """Find a camera's image of a frame; None if it took none."""
    names = (frame / f"{camera.name}{suffix}" for suffix in _SUFFIXES)
    return next((path for path in names if path.is_file()), None)
