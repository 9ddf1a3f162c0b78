"""Calibrated cameras in the files of sabench and of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from sabench.dataset.camera_files import read_calibrated
from sabench.dataset.hdf5_probe import probe
from sabench.dataset.results import read_result_cameras
from sabench.dataset.schema import CAMERAS
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.utils.errors import InputError

_RESULTS = (".h5", ".hdf5")


class CameraSource(NamedTuple):
    """Calibrated cameras, and the grid of their data set if they are of one."""

    cameras: tuple[CameraModel, ...]
    grid: Grid | None = None


def read_camera_source(path: Path) -> CameraSource:
    """Read calibrated cameras from a file or folder.

    They are a `cameras.json` of `sabench calibrate` or of a data set, a folder that holds one, or
    the result file of a solver of the task `calibration`, as `volume_self_calibration`.

    Raises
    ------
    InputError
        No cameras there, or broken ones.
    """
    if path.suffix in _RESULTS:
        probe(path)
        return CameraSource(read_result_cameras(path))
    file = path / CAMERAS if path.is_dir() else path
    if not file.is_file():
        raise InputError(
            f"{path}: expected {CAMERAS} of `sabench calibrate` or of a data set, or a folder with "
            "it, found none"
        )
    return CameraSource(*read_calibrated(file))
