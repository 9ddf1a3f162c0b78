"""Particles and tracks in the formats of other programs, and results of them.

docs/formats/foreign.md lists what each format carries.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np

from sabench.api import FoundParticles
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import result_writer
from sabench.geometry.grid import Grid
from sabench.interop import lpt_challenge, myptv, openlpt, openptv_files
from sabench.interop.foreign import LENGTHS_MM, Recording, TrackTable, check_form, note, read_world
from sabench.interop.named_columns import CSV, MATLAB, NETCDF, NamedColumns
from sabench.utils.arrays import F64
from sabench.utils.errors import LISTED, InputError, one_line
from sabench.utils.files import refuse_existing

TrackFormat = Literal["openptv", "myptv", "openlpt", "lpt-challenge", "netcdf", "mat", "csv"]
_MODULES: dict[str, ModuleType | NamedColumns] = {
    "openptv": openptv_files,
    "myptv": myptv,
    "openlpt": openlpt,
    "lpt-challenge": lpt_challenge,
    "netcdf": NETCDF,
    "mat": MATLAB,
    "csv": CSV,
}


def read_tracks(
    path: str | Path, form: TrackFormat, *, unit: str | None = None, interval_s: float | None = None
) -> TrackTable:
    """Read the particles of all frames, in the world of the files.

    Parameters
    ----------
    path : file, or folder of a result.
    unit : of lengths; None: as the file says, else mm.
    interval_s : time between frames, for velocities per frame.

    Raises InputError for an unknown format or unit, or a file that is missing or broken.
    """
    check_form("tracks", form, TrackFormat)
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: expected a file or folder with particles, found none")
    table: TrackTable = _MODULES[form].read_tracks(file, unit, interval_s)
    return table


def write_tracks(folder: Path, table: TrackTable, form: TrackFormat, recording: Recording) -> None:
    """Write particles into a folder, and note what the format cannot store.

    The particles are in the world of the files.
    """
    check_form("tracks", form, TrackFormat)
    note(f"{form}: its files of particles do not carry {'; '.join(_MODULES[form].LOST_OF_TRACKS)}")
    _MODULES[form].write_tracks(folder, table, recording)


_FEW = 0.1  # share of particles in the volume that is too small


@dataclass(frozen=True)
class ImportedResult:
    """Summary of an imported result.

    Attributes
    ----------
    path : of the result file.
    particles, frames, trajectories : numbers; trajectories is None where particles are not linked.
    """

    path: Path
    particles: int
    frames: int
    trajectories: int | None


def import_result(
    dataset: Dataset | str | Path,
    found: str | Path,
    out: str | Path,
    form: TrackFormat,
    *,
    unit: str | None = None,
    first: int | None = None,
    solver: str | None = None,
    overwrite: bool = False,
) -> ImportedResult:
    """Make a result file of the particles that another program found in a data set.

    A file `sabench-world.json` that `export` has written next to them, or up to two folders above,
    defines the coordinate system of the positions. By default it is that of the data set.

    Parameters
    ----------
    found : file, or folder of the program's result.
    unit : of lengths; None: as the files say, else mm, and lengths that cannot be mm are refused.
    first : number that the files give frame 0 of the data set; None: the smallest in the files.
    solver : name of the result; None: that of the format.

    Raises InputError for a missing data set, files that are missing or broken, frames that the data
    set does not have, positions in another unit, or an existing file.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    refuse_existing(Path(out), overwrite=overwrite)
    setup, source = data.setup, Path(found)
    recording = Recording(setup.cameras, tuple(setup.time_s(i) for i in range(setup.frames)))
    table = read_tracks(source, form, unit=unit, interval_s=recording.interval_s)
    table = _renumbered(source, table, first, setup.frames).back(read_world(source))
    _check_places(source, table, setup.grid, unit)
    estimates = [_estimate(source, table, frame) for frame in range(setup.frames)]
    parameters = {"format": form}
    with result_writer(
        Path(out), data, solver or form, "particles", parameters, overwrite=overwrite
    ) as writer:
        for frame, estimate in enumerate(estimates):
            writer.add(estimate, frame)
    tracks = None if table.trajectory is None else len(np.unique(table.trajectory))
    return ImportedResult(Path(out), len(table), setup.frames, tracks)


def _renumbered(source: Path, table: TrackTable, first: int | None, frames: int) -> TrackTable:
    """Count frames from 0, and note those without particles."""
    if not len(table):
        raise InputError(f"{source}: expected particles, found none")
    begin = int(table.frame[0]) if first is None else first
    frame = table.frame - begin
    if frame[0] < 0 or frame[-1] >= frames:
        raise InputError(
            f"{source}: expected the {frames} frames of the data set, from {begin} on, got frames "
            f"{table.frame[0]} to {table.frame[-1]}"
        )
    empty = np.setdiff1d(np.arange(frames), frame)
    if len(empty):
        listed = one_line(", ".join(map(str, empty + begin)), LISTED)
        note(f"{source}: no particles in the frames {listed}")
    return replace(table, frame=frame)


def _check_places(source: Path, table: TrackTable, grid: Grid, unit: str | None) -> None:
    """Refuse positions in another unit; note if they lie outside the volume."""
    share = _share_inside(grid, table.position_mm)
    if share >= _FEW:
        return
    scales = {} if unit is not None else {name: mm for name, mm in LENGTHS_MM.items() if mm != 1.0}
    shares = {name: _share_inside(grid, mm * table.position_mm) for name, mm in scales.items()}
    best = max(shares, key=shares.__getitem__, default="")
    if best and shares[best] > share:
        raise InputError(
            f"{source}: expected positions in mm, got {100.0 * share:.0f} % of them in the volume, "
            f"and {100.0 * shares[best]:.0f} % if they are in {best}: give the unit"
        )
    low, high = table.position_mm.min(axis=0), table.position_mm.max(axis=0)
    spans = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True))
    note(
        f"{source}: {100.0 * share:.0f} % of the particles lie in the volume; they run over "
        f"{spans} mm along x, y, z: check the axes, the origin and the unit"
    )


def _share_inside(grid: Grid, position_mm: F64) -> float:
    size = np.asarray(grid.shape[::-1])
    voxels = grid.to_voxels(position_mm) / size
    return float(((voxels >= 0.0) & (voxels < 1.0)).all(axis=1).mean())


def _estimate(source: Path, table: TrackTable, frame: int) -> FoundParticles:
    try:
        return table.estimate(frame)
    except InputError as error:
        raise InputError(f"{source}: frame {frame}: {error}") from error
