"""Points of a calibration in CSV files: points.csv, and a target's own points.

docs/using/calibrating.md describes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.tables import read_records
from sabench.utils.validation import printable

_FARTHEST_PX = 1e6  # of a point from the image's corner
_FARTHEST_MM = 1e6  # a kilometre
_MOST_PIXELS = 20_000_000  # pixels of points in all frames and cameras
_SIGMA_MM = 0.05  # of a coordinate whose standard deviation is not given
_AXES = ("x_mm", "y_mm", "z_mm")
_SIGMAS = ("sigma_x_mm", "sigma_y_mm", "sigma_z_mm")
_SEEN = ("camera", "frame", "point", "column", "row")
_ALIASES = {name.removesuffix("_mm"): name for name in (*_AXES, *_SIGMAS, "sigma_mm")}
_LARGEST = 2**31  # number of a frame or a point


@dataclass(frozen=True)
class Sightings:
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


def unseen(pixels: F64) -> Sightings:
    """Make sightings of pixels (camera, frame, point, 2) without known places."""
    frames, points = pixels.shape[1:3]
    nothing = np.full((frames, points, 3), np.nan)
    numbers = np.tile(np.arange(points), (frames, 1))
    return Sightings(pixels, nothing, nothing.copy(), np.arange(frames), numbers)


def read_sightings(path: Path, names: Sequence[str], count: int) -> Sightings:
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
    made = unseen(np.full((len(names), max(frames, 1), count, 2), np.nan))
    for line in lines:
        _enter(made, names, line, line.frame, line.point)
    return made


def read_loose_points(path: Path, names: Sequence[str]) -> Sightings:
    """Read a points.csv with measured places of points without a target.

    Each point of each frame is one of its own: the arrays have as many frames of one point.
    """
    lines = list(_lines(path, names))
    for line in lines:
        if not np.isfinite(line.known_mm).all():
            raise InputError(
                f"{line.where}: expected x_mm, y_mm and z_mm of every point, since "
                "calibration.toml has no target, got none"
            )
    labels = sorted({(line.frame, line.point) for line in lines})
    if not labels or max(map(max, labels)) > _LARGEST:
        raise InputError(
            f"{path}: expected points that cameras saw, with numbers up to {_LARGEST}, got "
            f"{len(labels)} points, the last one {labels[-1:]}"
        )
    rows = {label: number for number, label in enumerate(labels)}
    empty = unseen(np.full((len(names), len(labels), 1, 2), np.nan))
    frames, points = np.array(labels, dtype=np.int64).T
    made = Sightings(empty.pixels, empty.known_mm, empty.sigma_mm, frames, points[:, None])
    for line in lines:
        _enter(made, names, line, rows[line.frame, line.point], 0)
    return made


def read_target(path: Path) -> tuple[tuple[float, float, float], ...]:
    """Read a target's own points: columns point, x_mm, y_mm and z_mm, counted from 0."""
    places: dict[int, tuple[float, float, float]] = {}
    for where, line in read_records(path, ("point", *_AXES), (), _ALIASES):
        number = _whole(where, line, "point")
        x, y, z = (_length(where, line, name) for name in _AXES)
        if number in places:
            raise InputError(f"{where}: expected point {number} once, got it twice")
        places[number] = (x, y, z)
    if sorted(places) != list(range(len(places))) or len(places) < 3:
        raise InputError(
            f"{path}: expected three points or more, counted from 0, got {len(places)} with "
            f"numbers up to {max(places, default=0)}"
        )
    return tuple(places[number] for number in range(len(places)))


def _enter(made: Sightings, names: Sequence[str], line: _Line, frame: int, point: int) -> None:
    """Enter a line's pixel and place into the arrays."""
    camera = names.index(line.camera)
    if np.isfinite(made.pixels[camera, frame, point, 0]):
        raise InputError(
            f"{line.where}: {line.camera}, frame {line.frame}: expected point {line.point} once, "
            "got it twice"
        )
    made.pixels[camera, frame, point] = line.pixel
    given = np.isfinite(line.known_mm)
    before, now = made.known_mm[frame, point], np.asarray(line.known_mm)
    if (given & np.isfinite(before) & (before != now)).any():
        raise InputError(
            f"{line.where}: frame {line.frame}: expected one place of point {line.point} for all "
            f"cameras, got {before.tolist()} and {now.tolist()}"
        )
    made.known_mm[frame, point, given] = now[given]
    made.sigma_mm[frame, point, given] = np.asarray(line.sigma_mm)[given]


def _lines(path: Path, names: Sequence[str]) -> Iterator[_Line]:
    for where, line in read_records(path, _SEEN, (*_AXES, "sigma_mm", *_SIGMAS), _ALIASES):
        camera, frame, point = line["camera"], *(_whole(where, line, k) for k in _SEEN[1:3])
        if camera not in names:
            raise InputError(
                f"{where}: expected one of the cameras {', '.join(names)}, got {printable(camera)}"
            )
        column, row = (_number(where, line, name, _FARTHEST_PX, "px") for name in _SEEN[3:])
        known = [_length(where, line, k) if line.get(k) else np.nan for k in _AXES]
        sigmas = [_sigma(where, line, name) for name in _SIGMAS]
        yield _Line(where, camera, frame, point, (column, row), tuple(known), tuple(sigmas))


def _sigma(where: str, line: dict[str, str], name: str) -> float:
    """Read the standard deviation of a coordinate: its own, or that of all three."""
    key = name if line.get(name) else "sigma_mm"
    value = _length(where, line, key) if line.get(key) else _SIGMA_MM
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


def _length(where: str, line: dict[str, str], key: str) -> float:
    return _number(where, line, key, _FARTHEST_MM, "mm")


def _number(where: str, line: dict[str, str], key: str, most: float, unit: str) -> float:
    try:
        value = float(line[key])
    except ValueError:
        raise InputError(f"{where}: {key}: expected a number, got {printable(line[key])}") from None
    if not abs(value) <= most:
        raise InputError(
            f"{where}: {key}: expected a number of -{most:g} to {most:g} {unit}, got {value}"
        )
    return value
