"""Results of other programs as result files, which `sabench score` takes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sabench.api import FoundParticles
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import result_writer
from sabench.geometry.grid import Grid
from sabench.interop.foreign_world import LENGTHS_MM, note, read_world
from sabench.interop.tracks import TrackFormat, read_tracks
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.files import refuse_existing

_AROUND = 0.25  # of the volume's edges, at either side, where particles count as in it
_FEW, _MANY = 0.1, 0.5  # shares of particles in the volume that are too few, and usual
_LISTED = 10  # frames that a sentence lists


@dataclass(frozen=True)
class Imported:
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
) -> Imported:
    """Make a result file of the particles that another program found in a data set.

    A file `sabench-world.json` that `export` has written next to them, or up to two folders above,
    tells the world of the positions; without it, it is that of the data set.

    Parameters
    ----------
    found : file, or folder of the program's result.
    unit : of lengths; None: as the files say, else mm, and lengths that cannot be mm are refused.
    first : number that the files give frame 0 of the data set; None: the smallest in the files.
    solver : name of the result; None: that of the format.

    Raises
    ------
    InputError
        No data set, files that are missing or broken, frames that the data set does not have,
        positions in another unit, or an existing file.
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
        for frame, one in enumerate(estimates):
            writer.add(one, frame)
    tracks = None if table.trajectory is None else len(np.unique(table.trajectory))
    return Imported(Path(out), len(table), setup.frames, tracks)


def _renumbered(source: Path, table: TrackTable, first: int | None, frames: int) -> TrackTable:
    """Count frames from 0, and say which have no particle."""
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
        more = f" and {len(empty) - _LISTED} more" if len(empty) > _LISTED else ""
        note(
            f"{source}: no particles in the frames "
            f"{', '.join(str(one) for one in empty[:_LISTED] + begin)}{more}"
        )
    return replace(table, frame=frame)


def _check_places(source: Path, table: TrackTable, grid: Grid, unit: str | None) -> None:
    """Refuse positions in another unit; say if they lie outside the volume."""
    share = _share_inside(grid, table.position_mm)
    if share >= _FEW:
        return
    scales = {} if unit is not None else {name: mm for name, mm in LENGTHS_MM.items() if mm != 1.0}
    shares = {name: _share_inside(grid, mm * table.position_mm) for name, mm in scales.items()}
    best = max(shares, key=shares.__getitem__, default="")
    if best and shares[best] >= _MANY:
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
    """Compute the share of positions in the volume or close to it."""
    size = np.asarray(grid.shape[::-1])
    voxels = grid.to_voxels(position_mm) / size
    return float(((voxels >= -_AROUND) & (voxels < 1.0 + _AROUND)).all(axis=1).mean())


def _estimate(source: Path, table: TrackTable, frame: int) -> FoundParticles:
    """Make the estimate of a frame, and name the file in its faults."""
    try:
        return table.estimate(frame)
    except InputError as error:
        raise InputError(f"{source}: frame {frame}: {error}") from error
