"""Particles and bubbles in the formats of other programs, and results of them.

docs/formats/foreign.md lists what each format carries.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np

from sabench.api.estimates import Estimate
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import result_writer
from sabench.geometry.grid import Grid
from sabench.interop import lpt_challenge, myptv, openlpt, openptv_files
from sabench.interop.foreign import LENGTHS_MM, Recording, TrackTable, check_form, note, read_world
from sabench.interop.named_columns import CSV, MATLAB, NETCDF, NUMPY, NamedColumns
from sabench.utils.arrays import F64
from sabench.utils.errors import LISTED, InputError, one_line
from sabench.utils.files import refuse_existing

TrackFormat = Literal["openptv", "myptv", "openlpt", "lpt-challenge", "netcdf", "mat", "npy", "csv"]
_MODULES: dict[str, ModuleType | NamedColumns] = {
    "openptv": openptv_files,
    "myptv": myptv,
    "openlpt": openlpt,
    "lpt-challenge": lpt_challenge,
    "netcdf": NETCDF,
    "mat": MATLAB,
    "npy": NUMPY,
    "csv": CSV,
}


def read_tracks(
    path: str | Path,
    form: TrackFormat,
    *,
    unit: str | None = None,
    interval_s: float | None = None,
    **table: Any,
) -> TrackTable:
    """Read the particles or bubbles of all frames, in the world of the files.

    Parameters
    ----------
    path : file, or folder of a result.
    unit : of lengths; None: as the file says, else mm.
    interval_s : time between frames, for velocities per frame.
    table : names, single and bubbles of `NamedColumns`, for tables.

    Raises InputError for an unknown format or unit, or a file that is missing or broken.
    """
    check_form("tracks", form, TrackFormat)
    file, module = Path(path), _MODULES[form]
    if not file.exists():
        raise InputError(f"{file}: expected a file or folder with particles, found none")
    if isinstance(module, NamedColumns):
        module = replace(module, **table)
    elif table.get("names"):
        raise InputError(f"columns: expected with csv, npy, netcdf or mat, got them with {form}")
    found: TrackTable = module.read_tracks(file, unit, interval_s)
    return found


def write_tracks(folder: Path, table: TrackTable, form: TrackFormat, recording: Recording) -> None:
    """Write particles into a folder, and note what the format cannot store.

    The particles are in the world of the files.
    """
    check_form("tracks", form, TrackFormat)
    lost = (*_MODULES[form].LOST_OF_TRACKS, "light of each camera, covariances and probabilities")
    note(f"{form}: its files of particles do not carry {'; '.join(lost)}")
    _MODULES[form].write_tracks(folder, table, recording)


_FEW = 0.1  # share of particles in the volume that is too small


@dataclass(frozen=True)
class ImportedResult:
    """Summary of an imported result.

    Attributes
    ----------
    path : of the result file.
    task : particles or bubbles.
    found, frames, trajectories : numbers; trajectories is None where they are not linked.
    """

    path: Path
    task: Literal["particles", "bubbles"]
    found: int
    frames: int
    trajectories: int | None


def import_result(
    dataset: Dataset | str | Path,
    found: str | Path,
    out: str | Path,
    form: TrackFormat,
    *,
    task: str | None = None,
    columns: Sequence[str] = (),
    unit: str | None = None,
    first: int | None = None,
    solver: str | None = None,
    overwrite: bool = False,
) -> ImportedResult:
    """Make a result file of particles or bubbles that another program found.

    A file `sabench-world.json` that `export` has written next to them, or up to two folders above,
    defines the coordinate system of the positions. By default it is that of the data set.

    Parameters
    ----------
    found : file, or folder of the program's result.
    task : particles or bubbles; None: what the data set shows. Where it shows both, a table
        without sizes is one of particles, and one with sizes is refused.
    columns : names of a table's columns; empty: as the file says.
    unit : of lengths; None: as the files say, else mm, and lengths that cannot be mm are refused.
    first : number that the files give frame 0 of the data set; None: the smallest in the files.
    solver : name of the result; None: that of the format.

    Raises InputError for a missing data set, one that shows neither, files that are missing or
    broken, frames that the data set does not have, lengths in another unit, positions that all lie
    outside the volume, or an existing file.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    refuse_existing(Path(out), overwrite=overwrite)
    setup, source = data.setup, Path(found)
    interval_s = Recording(setup.cameras, tuple(map(setup.time_s, range(setup.frames)))).interval_s
    sized = task != "particles" and "bubbles" in data.shows
    more = {"names": columns, "single": setup.frames == 1, "bubbles": sized}
    table = read_tracks(source, form, unit=unit, interval_s=interval_s, **more)
    _check_kind(source, table, data, task)
    table = _renumbered(source, table, first, setup.frames).back(read_world(source))
    _check_places(source, table, setup.grid, unit)
    if table.semi_axes_mm is not None:
        _check_sizes(source, table.semi_axes_mm, setup.grid)
    estimates = [_estimate(source, table, frame) for frame in range(setup.frames)]
    name, head = solver or form, {"format": form}
    with result_writer(Path(out), data, name, table.kind, head, overwrite=overwrite) as writer:
        for frame, estimate in enumerate(estimates):
            writer.add(estimate, frame)
    tracks = None if table.trajectory is None else len(np.unique(table.trajectory))
    return ImportedResult(Path(out), table.kind, len(table), setup.frames, tracks)


def _check_kind(source: Path, table: TrackTable, data: Dataset, asked: str | None) -> None:
    """Refuse what is not of the asked task or of the data set's, or could be of two."""
    kinds = [kind for kind in ("particles", "bubbles") if kind in data.shows]
    if asked not in (None, *kinds) or not kinds:
        names = " or ".join(kinds) or "a data set with particles or bubbles"
        raise InputError(f"task: expected {names} for {data.root}, got {asked or data.shows[0]}")
    if asked is None and len(kinds) > 1 and table.kind == "bubbles":
        raise InputError(
            f"{source}: expected particles or bubbles of {data.root}, which shows both, got a "
            "table with sizes: give --task bubbles, or --task particles to leave out the sizes"
        )
    if table.kind == "particles" and (asked or kinds[0]) == "bubbles":
        raise InputError(
            f"{source}: expected bubbles of {data.root}, with a column radius or diameter, or "
            "semi-axes a, b and c, next to the positions, got none of these"
        )


def _renumbered(source: Path, table: TrackTable, first: int | None, frames: int) -> TrackTable:
    """Count frames from 0, and note those without particles or bubbles."""
    if not len(table):
        raise InputError(f"{source}: expected {table.kind}, found none")
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
        note(f"{source}: no {table.kind} in the frames {listed}")
    return replace(table, frame=frame)


def _check_places(source: Path, table: TrackTable, grid: Grid, unit: str | None) -> None:
    """Refuse positions in another unit, or all outside the volume; note if most are."""
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
    ends = table.position_mm.min(axis=0), table.position_mm.max(axis=0)
    spans, volume = (
        ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(*box, strict=True))
        for box in (ends, grid.box_mm)
    )
    sentence = (
        f"{source}: expected {table.kind} in the volume of {volume} mm along x, y, z, got "
        f"{100.0 * share:.0f} % of them there, over {spans}: check the axes, the origin, and that "
        "lengths are not in pixels"
    )
    if not share:
        raise InputError(sentence)
    note(sentence)


def _check_sizes(source: Path, semi_axes_mm: F64, grid: Grid) -> None:
    """Refuse bubbles smaller than a hundredth of a voxel, or wider than the volume."""
    radius = float(np.median(np.cbrt(semi_axes_mm.prod(axis=1))))
    least, most = 0.01 * min(grid.voxel_mm), np.ptp(grid.box_mm, axis=0).max() / 2.0
    if not least <= radius <= most:
        raise InputError(
            f"{source}: expected radii of {least:.2g} to {most:.4g} mm in this volume, got a "
            f"median of {radius:.3g} mm: give the unit, or that of the column, as in radius [m]"
        )


def _share_inside(grid: Grid, position_mm: F64) -> float:
    size = np.asarray(grid.shape[::-1])
    voxels = grid.to_voxels(position_mm) / size
    return float(((voxels >= 0.0) & (voxels < 1.0)).all(axis=1).mean())


def _estimate(source: Path, table: TrackTable, frame: int) -> Estimate:
    try:
        return table.estimate(frame)
    except InputError as error:
        raise InputError(f"{source}: frame {frame}: {error}") from error
