"""Cameras in sabench's own cameras.json, of a data set or of a calibration."""

from collections.abc import Sequence
from pathlib import Path

from sabench.dataset.cameras import read_calibrated, wall_entry, write_cameras as write_file
from sabench.dataset.schema import CAMERAS
from sabench.geometry.camera_model import CameraModel
from sabench.interop.foreign import ForeignWorld
from sabench.interop.lenses import Extent
from sabench.utils.arrays import F64


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Read the cameras of a file cameras.json, or of the folder that holds it.

    Raises InputError for a missing file, or a broken one.
    """
    return list(read_calibrated(path / CAMERAS if path.is_dir() else path)[0])


def write_cameras(
    folder: Path, cameras: Sequence[CameraModel], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write cameras.json."""
    write_file(folder / CAMERAS, cameras, wall=wall_entry(cameras))
