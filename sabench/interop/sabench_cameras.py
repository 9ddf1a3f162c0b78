"""Cameras in sabench's own cameras.json, of a data set or of a calibration."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from sabench.dataset.cameras import behind, check_walls, wall_entry, write_cameras as write_file
from sabench.dataset.schema import CAMERAS
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.camera_records import read_camera
from sabench.geometry.cylinder_wall import WallsRecord
from sabench.interop.foreign import ForeignWorld
from sabench.interop.lenses import Extent
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import read_json

_WALLS: TypeAdapter[Any] = TypeAdapter(WallsRecord | None)


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Read the cameras of a file cameras.json, or of the folder that holds it.

    Raises InputError for a missing file, or a broken one.
    """
    file = path / CAMERAS if path.is_dir() else path
    record = read_json(file)
    entries = record.get("cameras") if isinstance(record, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{file}: cameras: expected a list of cameras, got {entries!r}")
    cameras = [
        read_camera(
            {"model": "pinhole"} | entry if isinstance(entry, dict) else entry,
            f"{file}: cameras: {number}",
        )
        for number, entry in enumerate(entries)
    ]
    try:
        wall = _WALLS.validate_python(record.get("wall"))
    except ValidationError as error:
        raise InputError(f"{file}: wall: {error.errors()[0]['msg']}") from error
    walls = wall if isinstance(wall, tuple) else (wall,) * len(cameras)
    check_walls(file, walls, len(cameras))
    return list(behind(walls, cameras))


def write_cameras(
    folder: Path, cameras: Sequence[CameraModel], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write cameras.json."""
    write_file(folder / CAMERAS, cameras, wall=wall_entry(cameras))
