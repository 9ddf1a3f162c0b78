"""Folder of a calibration: calibration.toml, and points or images of a target.

docs/using/calibrating.md describes it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sabench.algorithms.calibration.resection import place_boards, upright_axes
from sabench.algorithms.calibration.target_detection import detect_target
from sabench.api import CalibrationCase
from sabench.api.truth import Target
from sabench.dataset.cameras import read_calibrated
from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.camera_records import check_largest
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.images.image_reading import read_photographs
from sabench.scenes.build import build_walls, wall_towards
from sabench.scenes.cameras import DistortionSpec
from sabench.scenes.wall import WallTable
from sabench.utils.arrays import F64, I64, LARGEST, UP, triple
from sabench.utils.errors import InputError
from sabench.utils.files import inside, read_toml
from sabench.utils.progress import progress_bar
from sabench.utils.tables import read_named_rows
from sabench.utils.validation import (
    Direction,
    Positive,
    Table,
    TiltAngle,
    Unknown,
    Vector,
    printable,
    validate,
)

_MOST_PIXELS = 20_000_000  # pixels of points in all frames and cameras
_SIGMA_MM = 0.05  # standard deviation of a coordinate if none is given
_AXES = ("x_mm", "y_mm", "z_mm")
_SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
_SEEN = ("camera", "frame", "point", "column", "row")
_ALIASES = {name.removesuffix("_mm"): name for name in (*_AXES, *_SIGMAS, "sigma_mm")}


@dataclass(frozen=True)
class _PointObservations:
    """Points that cameras saw, and what was measured of their places.

    Attributes
    ----------
    pixels : (camera, frame, point, 2) column and row; NaN where a point was not found.
    known_mm, sigma_mm : (frame, point, 3) measured coordinates, NaN where there are none.
    frames, points : (frame,) and (frame, point) numbers that the files give to them.
    """

    pixels: F64
    known_mm: F64
    sigma_mm: F64
    frames: I64
    points: I64


@dataclass(frozen=True)
class _Line:
    """Line of points.csv; coordinates (3,) are NaN where they are not given."""

    where: str
    camera: str
    frame: int
    point: int
    pixel: tuple[float, float]
    known_mm: tuple[float, ...]
    sigma_mm: tuple[float, ...]


def unseen(pixels: F64) -> _PointObservations:
    """Make sightings of pixels (camera, frame, point, 2) without known places."""
    frames, points = pixels.shape[1:3]
    nothing = np.full((frames, points, 3), np.nan)
    numbers = np.tile(np.arange(points), (frames, 1))
    return _PointObservations(pixels, nothing, nothing.copy(), np.arange(frames), numbers)


def read_sightings(path: Path, names: Sequence[str], count: int) -> _PointObservations:
    """Read the points.csv of a target with `count` points, counted from 0.

    Parameters
    ----------
    names : of the cameras.
    """
    lines = list(_lines(path, names))
    frames = 1 + max((line.frame for line in lines), default=-1)
    most = min(len(lines), _MOST_PIXELS // (len(names) * count))
    if frames > most:
        raise InputError(
            f"{path}: expected frames counted from 0 and at most {most}, for {len(lines)} points "
            f"found, got frame {frames - 1}"
        )
    for line in lines:
        if line.point >= count:
            raise InputError(
                f"{path}: expected points 0 to {count - 1}, got {line.camera}, frame "
                f"{line.frame}, point {line.point}"
            )
    sightings = unseen(np.full((len(names), max(frames, 1), count, 2), np.nan))
    for line in lines:
        _enter(sightings, names, line, line.frame, line.point)
    return sightings


def read_loose_points(path: Path, names: Sequence[str]) -> _PointObservations:
    """Read a points.csv with measured places of points without a target.

    Points are not matched between frames: each point of each frame becomes a frame of one point.
    """
    lines = list(_lines(path, names))
    for line in lines:
        if not np.isfinite(line.known_mm).all():
            raise InputError(
                f"{line.where}: expected x_mm, y_mm and z_mm of every point, since "
                "calibration.toml has no target, got none"
            )
    labels = sorted({(line.frame, line.point) for line in lines})
    if not labels or max(map(max, labels)) > LARGEST:
        raise InputError(
            f"{path}: expected points that cameras saw, with numbers up to {LARGEST:g}, got "
            f"{len(labels)} points, the last one {labels[-1:]}"
        )
    rows = {label: number for number, label in enumerate(labels)}
    empty = unseen(np.full((len(names), len(labels), 1, 2), np.nan))
    frames, points = np.array(labels, dtype=np.int64).T
    sightings = _PointObservations(
        empty.pixels, empty.known_mm, empty.sigma_mm, frames, points[:, None]
    )
    for line in lines:
        _enter(sightings, names, line, rows[line.frame, line.point], 0)
    return sightings


def read_target_points(path: Path) -> tuple[tuple[float, float, float], ...]:
    """Read a target's own points: columns point, x_mm, y_mm and z_mm, counted from 0."""
    places: dict[int, tuple[float, float, float]] = {}
    for where, line in read_named_rows(path, ("point", *_AXES), (), _ALIASES):
        number = _whole(where, line, "point")
        x, y, z = (_number(where, line, name) for name in _AXES)
        if number in places:
            raise InputError(f"{where}: expected point {number} once, got it twice")
        places[number] = (x, y, z)
    if sorted(places) != list(range(len(places))) or len(places) < 3:
        raise InputError(
            f"{path}: expected three points or more, counted from 0, got {len(places)} with "
            f"numbers up to {max(places, default=0)}"
        )
    return tuple(places[number] for number in range(len(places)))


def _enter(
    sightings: _PointObservations, names: Sequence[str], line: _Line, frame: int, point: int
) -> None:
    """Enter a line's pixel and place into the arrays."""
    camera = names.index(line.camera)
    if np.isfinite(sightings.pixels[camera, frame, point, 0]):
        raise InputError(
            f"{line.where}: {line.camera}, frame {line.frame}: expected point {line.point} once, "
            "got it twice"
        )
    sightings.pixels[camera, frame, point] = line.pixel
    given = np.isfinite(line.known_mm)
    before, now = sightings.known_mm[frame, point], np.asarray(line.known_mm)
    if (given & np.isfinite(before) & (before != now)).any():
        raise InputError(
            f"{line.where}: frame {line.frame}: expected one place of point {line.point} for all "
            f"cameras, got {before.tolist()} and {now.tolist()}"
        )
    sightings.known_mm[frame, point, given] = now[given]
    sightings.sigma_mm[frame, point, given] = np.asarray(line.sigma_mm)[given]


def _lines(path: Path, names: Sequence[str]) -> Iterator[_Line]:
    for where, line in read_named_rows(path, _SEEN, (*_AXES, "sigma_mm", *_SIGMAS), _ALIASES):
        camera, frame, point = line["camera"], *(_whole(where, line, k) for k in _SEEN[1:3])
        if camera not in names:
            raise InputError(
                f"{where}: expected one of the cameras {', '.join(names)}, got {printable(camera)}"
            )
        column, row = (_number(where, line, name) for name in _SEEN[3:])
        position = [_number(where, line, k) if line.get(k) else np.nan for k in _AXES]
        sigmas = [_sigma(where, line, name) for name in _SIGMAS]
        yield _Line(where, camera, frame, point, (column, row), tuple(position), tuple(sigmas))


def _sigma(where: str, line: dict[str, str], name: str) -> float:
    """Read the standard deviation of a coordinate: its own, or that of all three."""
    key = name if line.get(name) else "sigma_mm"
    value = _number(where, line, key) if line.get(key) else _SIGMA_MM
    if value <= 0.0:
        raise InputError(f"{where}: {key}: expected a positive length, got {value:g}")
    return value


def _whole(where: str, line: dict[str, str], key: str) -> int:
    try:
        value = int(line[key])
    except ValueError:
        raise InputError(
            f"{where}: {key}: expected a whole number, got {printable(line[key])}"
        ) from None
    if value < 0:
        raise InputError(f"{where}: {key}: expected a number from 0, got {value}")
    return value


def _number(where: str, line: dict[str, str], key: str) -> float:
    try:
        value = float(line[key])
    except ValueError:
        raise InputError(f"{where}: {key}: expected a number, got {printable(line[key])}") from None
    check_largest({key: value}, where)
    return value


class TargetSpec(Table):
    """Calibration target with a regular pattern."""

    pattern: Literal["checkerboard", "circles", "charuco", "wand"]
    columns: Annotated[int, Field(ge=1, le=200)]
    rows: Annotated[int, Field(ge=1, le=200)]
    pitch_mm: Positive
    mark_mm: Annotated[float, Field(ge=0.0)] = 0.0


class ArraySpec(Table):
    """Properties that all cameras share, as far as they are known."""

    rows: Annotated[int, Field(ge=8, le=20000)]
    columns: Annotated[int, Field(ge=8, le=20000)]
    pixel_mm: Positive
    focal_length_mm: Positive
    principal_distance_mm: Positive | None = Field(None, description="by default the focal length")


class _NominalCamera(Table):
    """Initial guess of a camera's position, and the point that it is aimed at.

    Its lens and sensor, where they are not those of the array.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]+$")]
    center_mm: Vector
    aim_mm: Vector
    up: Direction | None = Field(
        None, description="direction of the world that its images show upwards"
    )
    pixel_mm: Positive | None = None
    focal_length_mm: Positive | None = None
    principal_distance_mm: Positive | None = None
    principal_point_px: tuple[float, float] | None = Field(
        None, description="column and row; by default the centre of the image"
    )
    distortion: DistortionSpec = DistortionSpec()
    tilt_deg: tuple[TiltAngle, TiltAngle] = Field(
        UPRIGHT, description="of the sensor against the lens"
    )


class KnownSpec(Table):
    """Measured position of a point of the target, or of a complete frame.

    Coordinates that were not measured are left out.
    """

    frame: Annotated[int, Field(ge=0)]
    point: Annotated[int, Field(ge=0)] | None = Field(
        None, description="by default all points: the target stands in a plane of that coordinate"
    )
    x_mm: float | None = None
    y_mm: float | None = None
    z_mm: float | None = None
    sigma_mm: Positive = _SIGMA_MM


class Configuration(Table):
    """Content of calibration.toml."""

    target: TargetSpec | None = None
    target_points: str | None = Field(
        None,
        min_length=1,
        description="file of a rigid target of any shape: columns point,x_mm,y_mm,z_mm; without it "
        "and without `target`, points.csv has the measured place of every point",
    )
    up: Direction = Field(UP, description="direction of the world that images show upwards")
    array: ArraySpec | None = None
    wall: WallTable | None = None
    cameras: tuple[_NominalCamera, ...] = ()
    known_cameras: str | None = Field(
        None,
        min_length=1,
        description="cameras.json of an earlier calibration, as without the tank, in place of "
        "`array` and `cameras`: only the wall and the target are unknown",
    )
    target_mm: Vector | None = Field(
        None, description="initial guess of the target's position; by default the mean of aim_mm"
    )
    known: tuple[KnownSpec, ...] = ()
    unknown: tuple[Unknown, ...] = Field(
        (), description="parameters of lenses and wall to be found besides the focal lengths"
    )


CONFIGURATION, IMAGES, POINTS = "calibration.toml", "images", "points.csv"
_SUFFIXES = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Recording:
    """Calibration case of a folder, with the numbers of its frames and points.

    Attributes
    ----------
    case : the case. Without a target each of its frames is one point.
    frames, points : (frame,) and (frame, point) numbers.
    """

    case: CalibrationCase
    frames: I64
    points: I64


def read_case(folder: Path) -> Recording:
    """Read a folder's calibration: its points.csv, or else points of its images."""
    path = folder / CONFIGURATION
    if not path.is_file():
        raise InputError(f"{path}: expected the description of a calibration, found none")
    values = read_toml(path)
    configuration = validate(Configuration, values, str(path))
    check_largest(values, str(path))
    if configuration.known_cameras is None:
        cameras = _cameras(configuration, str(path))
    else:
        cameras = _known_cameras(configuration, folder)
    target = _target(configuration, folder)
    # guess where the target is: as configured, or where cameras are aimed
    aims = [camera.aim_mm for camera in configuration.cameras]
    plain = target.points_mm @ upright_axes(cameras).T + np.asarray(
        configuration.target_mm or triple(np.mean(aims, axis=0))
    )
    names = [camera.name for camera in cameras]
    if len(plain) == 1 and target.pattern == "points":
        sightings = read_loose_points(folder / POINTS, names)
    elif (folder / POINTS).is_file():
        sightings = read_sightings(folder / POINTS, names, len(plain))
    elif target.pattern == "points":
        raise InputError(
            f"{folder / POINTS}: expected the points that cameras saw, since points of any places "
            "are not detected in images, found none"
        )
    else:
        sightings = unseen(_read_images(folder / IMAGES, target, cameras, plain))
    _enter_known(configuration, sightings, str(path))
    initial = np.tile(plain, (sightings.pixels.shape[1], 1, 1))
    case = CalibrationCase(
        target,
        sightings.pixels,
        cameras,
        initial,
        sightings.known_mm,
        sightings.sigma_mm,
        configuration.unknown,
        configuration.known_cameras is not None,
    )
    case = replace(case, initial_mm=place_boards(case))
    return Recording(case, sightings.frames, sightings.points)


def _target(configuration: Configuration, folder: Path) -> Target:
    """Make the target; without one, a single point for each of the points."""
    spec, points = configuration.target, configuration.target_points
    if spec is not None and points is not None:
        raise InputError(
            f"{folder / CONFIGURATION}: expected either target or target_points, got both"
        )
    if spec is not None:
        return Target(**spec.model_dump())
    if points is not None:
        return Target.from_places(read_target_points(inside(folder, points)))
    return Target.from_places(((0.0, 0.0, 0.0),))


def _cameras(configuration: Configuration, source: str) -> tuple[Camera, ...]:
    walls = build_walls(configuration.wall)
    shared, cameras = configuration.array, []
    if shared is None or not configuration.cameras:
        raise InputError(f"{source}: expected tables array and cameras, or known_cameras, got less")
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
            rotation=aimed_rotation(np.array([0.0, 0.0, 1.0])),  # until the camera is aimed
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
            down = -np.asarray(spec.up or configuration.up)
            cameras.append(aim(camera, spec.aim_mm, down))
        except ValueError as error:
            raise InputError(
                f"{source}: {error}: is the wall behind the camera, or the target in front of the "
                "wall?"
            ) from error
    return tuple(cameras)


def _known_cameras(configuration: Configuration, folder: Path) -> tuple[Camera, ...]:
    """Read the cameras of an earlier calibration, and put them in front of the wall."""
    path = folder / CONFIGURATION
    if configuration.array is not None or configuration.cameras:
        raise InputError(f"{path}: expected either known_cameras or array and cameras, got both")
    if configuration.target_mm is None:
        raise InputError(f"{path}: target_mm: expected it with known_cameras, got none")
    read, _ = read_calibrated(inside(folder, configuration.known_cameras or ""))
    walls, middle = build_walls(configuration.wall), np.asarray(configuration.target_mm)
    cameras = tuple(
        replace(camera, wall=wall_towards(walls, np.asarray(camera.center_mm), middle))
        for camera in read
        if isinstance(camera, Camera)
    )
    if len(cameras) < len(read):
        raise InputError(f"{path}: known_cameras: expected pinholes, got another camera model")
    return cameras


def _enter_known(configuration: Configuration, sightings: _PointObservations, source: str) -> None:
    """Enter the measured coordinates of the configuration.

    A coordinate of a whole frame has one error, which is spread over its points.
    """
    for number, spec in enumerate(configuration.known):
        chosen = sightings.frames[:, None] == spec.frame
        if spec.point is None:
            chosen = chosen & np.ones_like(sightings.points, dtype=np.bool_)
        else:
            chosen = chosen & (sightings.points == spec.point)
        if not chosen.any():
            frames, points = len(np.unique(sightings.frames)), sightings.points.max() + 1
            raise InputError(
                f"{source}: known.{number}: expected one of {frames} frames and of {points} "
                f"points, got {spec.frame} and {spec.point}"
            )
        sigma = spec.sigma_mm * np.sqrt(chosen.sum())
        for axis, value in enumerate((spec.x_mm, spec.y_mm, spec.z_mm)):
            if value is not None:
                sightings.known_mm[chosen, axis], sightings.sigma_mm[chosen, axis] = value, sigma


def _read_images(folder: Path, target: Target, cameras: tuple[Camera, ...], plain: F64) -> F64:
    """Detect the target in images/FRAME/CAMERA.tif (or png, bmp, jpg).

    Frames are in the order of their folders' names.
    """
    entries = folder.iterdir() if folder.is_dir() else ()
    frames = sorted(entry for entry in entries if entry.is_dir())
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
            pixels[c, k] = detect_target(image, target, cameras[c].project(plain)[0])
    return pixels


def _find(frame: Path, camera: Camera) -> Path | None:
    """Find a camera's image of a frame; None if it took none."""
    names = (frame / f"{camera.name}{suffix}" for suffix in _SUFFIXES)
    return next((path for path in names if path.is_file()), None)
