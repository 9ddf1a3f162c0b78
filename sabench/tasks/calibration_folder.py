"""Folder of a calibration: its configuration, and points or images of a target.

docs/using/calibrating.md describes it.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from sabench.algorithms.calibration.target_detection import detect
from sabench.api import CalibrationCase
from sabench.api.truth import Pattern, Target
from sabench.geometry.camera import Camera, Distortion, aim, aimed_rotation
from sabench.scenes.build import build_wall
from sabench.scenes.wall import WallSpec
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.fields import LensNumber, Positive, Vector
from sabench.utils.progress import progress_bar
from sabench.utils.validation import validate

CONFIGURATION, IMAGES, POINTS = "calibration.toml", "images", "points.csv"
_SUFFIXES = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class TargetSpec(_Table):
    """Calibration target that the cameras see."""

    pattern: Pattern
    columns: Annotated[int, Field(ge=1, le=200)]
    rows: Annotated[int, Field(ge=1, le=200)]
    pitch_mm: Positive
    mark_mm: Annotated[float, Field(ge=0.0)] = 0.0


class ArraySpec(_Table):
    """Properties that all cameras share, as far as they are known."""

    rows: Annotated[int, Field(ge=8, le=20000)]
    columns: Annotated[int, Field(ge=8, le=20000)]
    pixel_mm: Positive
    focal_length_mm: Positive
    principal_distance_mm: Positive | None = Field(None, description="by default the focal length")


class CameraSpec(_Table):
    """Initial guess of a camera's position, and the point that it is aimed at."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    center_mm: Vector
    aim_mm: Vector


class KnownSpec(_Table):
    """Point of the target whose position was measured.

    Coordinates that were not measured are left out.
    """

    frame: Annotated[int, Field(ge=0)]
    point: Annotated[int, Field(ge=0)]
    x_mm: float | None = None
    y_mm: float | None = None
    z_mm: float | None = None
    sigma_mm: Positive = 0.05


class Configuration(_Table):
    """Content of calibration.toml."""

    target: TargetSpec
    array: ArraySpec
    wall: WallSpec | None = None
    cameras: Annotated[tuple[CameraSpec, ...], Field(min_length=2)]
    target_mm: Vector = Field(description="initial guess of the target's position")
    known: tuple[KnownSpec, ...] = ()
    unknown: tuple[LensNumber, ...] = Field(
        (), description="parameters of the lenses to be found besides their focal lengths"
    )


def read_case(folder: Path) -> CalibrationCase:
    """Read a folder's calibration: its points.csv, or else points of its images."""
    path = folder / CONFIGURATION
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: expected the description of a calibration, found none") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a TOML file, got {error}") from error
    configuration = validate(Configuration, values, str(path))
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


def _cameras(configuration: Configuration, source: str) -> tuple[Camera, ...]:
    wall = build_wall(configuration.wall) if configuration.wall else None
    shared, cameras = configuration.array, []
    names = [spec.name for spec in configuration.cameras]
    if len(set(names)) != len(names):
        raise InputError(f"{source}: cameras: expected different names, got {names}")
    for spec in configuration.cameras:
        camera = Camera(
            name=spec.name,
            rows=shared.rows,
            columns=shared.columns,
            center_mm=spec.center_mm,
            rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),
            principal_distance_mm=shared.principal_distance_mm or shared.focal_length_mm,
            pixel_mm=shared.pixel_mm,
            principal_point_px=((shared.columns - 1) / 2.0, (shared.rows - 1) / 2.0),
            distortion=Distortion(),
            focal_length_mm=shared.focal_length_mm,
            f_number=8.0,
            wall=wall,
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
    expected = ["camera", "frame", "point", "column", "row"]
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames != expected:
            raise InputError(
                f"{path}: expected the first line {','.join(expected)}, got "
                f"{','.join(reader.fieldnames or ())}"
            )
        for number, line in enumerate(reader, 2):
            try:
                values = (
                    line["camera"],
                    int(line["frame"]),
                    int(line["point"]),
                    float(line["column"]),
                    float(line["row"]),
                )
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"{path}: line {number}: expected a name, two whole numbers and two numbers, "
                    f"got {error}"
                ) from error
            if not (math.isfinite(values[3]) and math.isfinite(values[4])):
                raise InputError(
                    f"{path}: line {number}: expected finite pixels, got {values[3]}, {values[4]}"
                )
            yield values


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
    steps = [(c, k) for c in range(len(cameras)) for k in range(len(frames))]
    pixels = np.full((len(cameras), len(frames), len(target.points_mm), 2), np.nan)
    for c, k in progress_bar(steps, "find the target"):
        image = _image(frames[k], cameras[c])
        if image is not None:
            pixels[c, k] = detect(image, target, cameras[c].project(plain)[0])
    return pixels


def _image(frame: Path, camera: Camera) -> npt.NDArray[np.uint16] | None:
    """Read a camera's image of a frame; None if it took none."""
    import cv2

    path = next(
        (
            frame / f"{camera.name}{suffix}"
            for suffix in _SUFFIXES
            if (frame / f"{camera.name}{suffix}").is_file()
        ),
        None,
    )
    if path is None:
        return None
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None:
        raise InputError(f"{path}: expected an image, got something else")
    if image.shape != (camera.rows, camera.columns):
        raise InputError(
            f"{path}: expected {camera.rows} x {camera.columns} pixels (rows x columns), got "
            f"{image.shape[0]} x {image.shape[1]}"
        )
    return np.asarray(image, dtype=np.uint16)
