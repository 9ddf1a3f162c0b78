"""Readers and writers of cameras in the formats of other programs.

docs/formats/foreign.md lists what each format carries.
"""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Literal, NamedTuple

from sabench.dataset.cameras import read_calibrated
from sabench.dataset.results import read_result_cameras
from sabench.dataset.schema import CAMERAS
from sabench.dataset.verification import probe
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import lattice_of
from sabench.geometry.grid import Grid
from sabench.interop import (
    lpt_challenge,
    matlab_cameras,
    myptv,
    opencv_cameras,
    openlpt_cameras,
    openptv_files,
    sabench_cameras,
)
from sabench.interop.foreign import ForeignWorld, check_form, note, unit_mm
from sabench.interop.lenses import Extent, check_unit, choose_indices, scaled_camera
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing

CameraFormat = Literal[
    "openptv", "myptv", "openlpt", "opencv", "matlab", "lpt-challenge", "sabench-calibration"
]
_MODULES: dict[str, ModuleType] = {
    "openptv": openptv_files,
    "myptv": myptv,
    "openlpt": openlpt_cameras,
    "opencv": opencv_cameras,
    "matlab": matlab_cameras,
    "lpt-challenge": lpt_challenge,
    "sabench-calibration": sabench_cameras,
}


def read_cameras(
    path: str | Path,
    form: CameraFormat,
    *,
    unit: str | None = None,
    size: tuple[int, int] | None = None,
    grid: Grid | None = None,
    points: tuple[F64, F64] | None = None,
) -> tuple[CameraModel, ...]:
    """Read the cameras of another program.

    The world is that of the files. What had to be changed or assumed is said by warnings of the
    class `ForeignFormatWarning`.

    Parameters
    ----------
    path : folder or file; a folder holds all cameras of a project.
    form : name of the format.
    unit : of the file's lengths; None: mm, and lengths that cannot be mm are refused.
    size : rows and columns of the images, for formats that leave them out.
    grid : measured volume, which polynomial cameras need.
    points : known points (n, 3) in the file's world and their pixels (camera, n, 2), to recognise
        exchanged refractive indices in the file. Without points, a note reports indices
        that look exchanged.

    Raises InputError for an unknown format or unit, a file that is missing or broken, a camera that
    is missing, or lengths in another unit.
    """
    check_form("cameras", form, CameraFormat)
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: expected a file or folder with cameras, found none")
    low, high = (None, None) if grid is None else map(triple, grid.centers_mm())
    cameras: list[CameraModel] = _MODULES[form].read_cameras(file, Extent(size, low, high))
    _check_names(file, cameras)
    if points is not None:
        cameras = choose_indices(file, cameras, *points)
    check_unit(file, cameras, unit)
    factor = 1.0 if unit is None else unit_mm(unit)
    return tuple(scaled_camera(camera, factor) for camera in cameras)


def write_cameras(
    folder: str | Path,
    cameras: Sequence[CameraModel],
    form: CameraFormat,
    *,
    grid: Grid | None = None,
    overwrite: bool = False,
) -> Path:
    """Write cameras into a new folder, and note what the format cannot store.

    With a grid, OpenPTV's world has its origin in the grid's centre, its Y axis up and its Z axis
    towards the cameras; `foreign.read_world` finds it. The point list needs the grid, and so
    do MyPTV's polynomials.

    Raises InputError for an unknown format, a camera that it cannot describe, or an existing
    folder.
    """
    check_form("cameras", form, CameraFormat)
    check_writable(cameras, form)
    with complete_or_nothing(Path(folder), overwrite=overwrite) as partial:
        partial.mkdir()
        write_into(partial, cameras, form, grid)
    return Path(folder)


def write_into(
    folder: Path, cameras: Sequence[CameraModel], form: CameraFormat, grid: Grid | None
) -> ForeignWorld:
    """Write cameras into a folder that is there; return the world of its files."""
    from sabench.interop.openptv import world_of

    world = world_of(grid) if form == "openptv" and grid is not None else ForeignWorld()
    points = None if grid is None else lattice_of(grid)
    try:
        _MODULES[form].write_cameras(folder, cameras, world, points)
    except ValueError as error:
        raise InputError(f"{form}: {error}") from error
    if world != ForeignWorld():
        world.write(folder)
    if lost := getattr(_MODULES[form], "LOST_OF_CAMERAS", ()):
        note(f"{form}: its camera files do not carry {'; '.join(lost)}")
    return world


def check_writable(cameras: Sequence[CameraModel], form: CameraFormat) -> None:
    """Raise an InputError if a format cannot describe some cameras."""
    unfit = getattr(_MODULES[form], "unfit", None)  # without it, a format has all cameras
    if unfit and (reason := unfit(cameras)):
        raise InputError(f"{form}: {reason}")


def _check_names(path: Path, cameras: Sequence[CameraModel]) -> None:
    names = [camera.name for camera in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: expected cameras of different names, got {twice} twice")


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

    Sources are a `cameras.json` of `sabench calibrate` or of a data set, a folder with one, the
    result file of a solver of the task `calibration`, such as `volume_self_calibration`, or files
    of another program (see `interop.cameras.read_cameras`).

    Parameters
    ----------
    form : format of another program; None: sabench's own.
    unit : of the other program's lengths; None: mm.
    size : rows and columns of the images, for formats that leave them out.
    grid : measured volume, for cameras that are polynomials of it.

    Raises InputError for missing cameras, or broken ones; a unit of sabench's own cameras, which
    are in mm.
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
