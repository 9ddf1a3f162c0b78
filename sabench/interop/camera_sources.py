"""Calibrated cameras in the files of sabench and of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from sabench.dataset.cameras import read_calibrated
from sabench.dataset.results import read_result_cameras
from sabench.dataset.schema import CAMERAS
from sabench.dataset.verification import probe
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.interop.cameras import CameraFormat, read_cameras
from sabench.utils.errors import InputError

_RESULTS = (".h5", ".hdf5")


class CameraSource(NamedTuple):
    """Calibrated cameras, and the grid of their data set if they are of one."""

    cameras: tuple[CameraModel, ...]
    grid: Grid | None = None


def read_camera_source(
    path: Path,
    form: CameraFormat | None = None,
    *,
    unit: str | None = None,
    size: tuple[int, int] | None = None,
    grid: Grid | None = None,
) -> CameraSource:
    """Read calibrated cameras from a file or folder.

    They are a `cameras.json` of `sabench calibrate` or of a data set, a folder that holds one, the
    result file of a solver of the task `calibration`, as `volume_self_calibration`, or files of
    another program, of which `interop.cameras.read_cameras` tells more.

    Parameters
    ----------
    form : format of another program; None: sabench's own.
    unit : of the other program's lengths; None: mm.
    size : rows and columns of the images, for formats that leave them out.
    grid : measured volume, for cameras that are polynomials of it.

    Raises
    ------
    InputError
        No cameras there, or broken ones; a unit of sabench's own cameras, which are in mm.
    """
    if form is not None:
        return CameraSource(read_cameras(path, form, unit=unit, size=size, grid=grid))
    if unit is not None:
        raise InputError(f"{path}: expected no unit for cameras of sabench, in mm, got {unit}")
    if path.suffix in _RESULTS:
        probe(path)
        return CameraSource(read_result_cameras(path))
    file = path / CAMERAS if path.is_dir() else path
    if not file.is_file() or file.suffix != ".json":
        raise InputError(
            f"{path}: expected {CAMERAS} of `sabench calibrate` or of a data set, or a folder with "
            "it; cameras of another program need --from"
        )
    return CameraSource(*read_calibrated(file))
