"""Results of OpenPTV: links, correspondences and targets of each frame.

ptv_is: the number of particles, then for each the rows in the frame before (-1: none) and after
(-2: none), and X Y Z. rt_is: the number, then a count from 1, X Y Z and the targets of four
cameras (-1: none). Targets: the number, then for each a count from 0, column and row (the centre of
the first pixel is 0.5, 0.5), pixels in all, along X and along Y, their sum of grey values, and the
row in rt_is (-1: none).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sabench.geometry.camera_model import CameraModel
from sabench.interop.foreign_world import note, unit_mm
from sabench.interop.openptv import join_links
from sabench.interop.tracks.track_table import Recording, TrackTable
from sabench.utils.arrays import F64, I64
from sabench.utils.errors import InputError
from sabench.utils.tables import content_lines, numbered_files, read_table, split_numbers

FIRST = 10001  # number of our frame 0 in the names of files
LOST = (
    "intensities, velocities and accelerations of particles",
    "light of each camera, covariances and probabilities",
    "sizes of targets (they are 3 x 3 pixels)",
)
_SIDE = 3  # of targets, whose size is not known
_CAMERAS = 4  # columns of rt_is


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read the frames of a folder, of `res` in it, or of the folder of a file.

    Links are read from ptv_is files; without them, particles from rt_is files.

    Raises
    ------
    InputError
        No such file, or a broken one.
    """
    places = [path / "res", path] if path.is_dir() else [path.parent]
    found = [
        (kind, files)
        for place in places
        if place.is_dir()
        for kind in ("ptv_is", "rt_is")
        if (files := list(numbered_files(place, rf"{kind}\.(?P<frame>\d+)")))
    ]
    if not found:
        raise InputError(f"{path}: expected files ptv_is.N or rt_is.N, in it or in res, found none")
    kind, files = found[0]
    if kind == "rt_is":
        note(f"{path}: found no ptv_is files: the particles have no trajectories")
    first = 2 if kind == "ptv_is" else 1
    tables = [_read_frame(file, 5 if kind == "ptv_is" else 4) for _, file in files]
    counts = [len(one) for one in tables]
    factor = 1.0 if unit is None else unit_mm(unit)
    position = np.concatenate([one[:, first : first + 3] for one in tables]) * factor
    frame = np.repeat([number for number, _ in files], counts).astype(np.int64)
    trajectory = _join([number for number, _ in files], tables) if kind == "ptv_is" else None
    return TrackTable(frame, position, trajectory)


def _read_frame(path: Path, least: int) -> F64:
    """Read one file; columns beyond the known ones are left out."""
    head = next(iter(content_lines(path)), None)
    if head is None:
        raise InputError(f"{path}: expected the number of particles, got an empty file")
    (count,) = split_numbers(head[1], f"{path}: line {head[0]}", 1)
    values = read_table(path, least, skip_lines=head[0]).values
    if count != len(values):
        raise InputError(
            f"{path}: line {head[0]}: expected {len(values)}, the number of lines below, got "
            f"{count:g}"
        )
    return values[:, :least]


def _join(numbers: Sequence[int], tables: Sequence[F64]) -> I64:
    """Assign numbers of trajectories; none goes over a frame without a file."""
    links = [
        table[:, 0].astype(int).tolist() if number - 1 in numbers else [-1] * len(table)
        for number, table in zip(numbers, tables, strict=True)
    ]
    return np.concatenate(join_links([len(table) for table in tables], links))


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write rt_is.N and ptv_is.N of all frames, and the targets of the cameras.

    Cameras and particles are in one world, which is that of the files.
    """
    cameras, frames = recording.cameras, recording.frames
    (folder / "res").mkdir()
    (folder / "img").mkdir(exist_ok=True)
    parts = [table.of_frame(frame) for frame in range(frames)]
    for frame, own in enumerate(parts):
        seen = _write_targets(folder, own, cameras, FIRST + frame)
        rows = np.full((len(own), _CAMERAS), -1)
        rows[:, : len(cameras)] = seen[:, :_CAMERAS]
        lines = [
            f"{n:4d} {x!r} {y!r} {z!r} " + " ".join(map(str, row))
            for n, ((x, y, z), row) in enumerate(
                zip(own.position_mm.tolist(), rows.tolist(), strict=True), 1
            )
        ]
        _write(folder / "res" / f"rt_is.{FIRST + frame}", lines)
    for frame, own in enumerate(parts):
        before = _rows_in(own, parts[frame - 1]) if frame else np.full(len(own), -1)
        after = _rows_in(own, parts[frame + 1]) if frame + 1 < frames else np.full(len(own), -1)
        after[after < 0] = -2
        lines = [
            f"{a:4d} {b:4d} {x!r} {y!r} {z!r}"
            for a, b, (x, y, z) in zip(
                before.tolist(), after.tolist(), own.position_mm.tolist(), strict=True
            )
        ]
        _write(folder / "res" / f"ptv_is.{FIRST + frame}", lines)


def _write(path: Path, lines: Sequence[str]) -> None:
    path.write_text("\n".join([str(len(lines)), *lines]) + "\n", encoding="utf-8")


def _rows_in(own: TrackTable, other: TrackTable) -> I64:
    """Find the rows of the same trajectories in another frame; -1 for none."""
    if own.trajectory is None or other.trajectory is None or not len(other):
        return np.full(len(own), -1)
    order = np.argsort(other.trajectory)
    place = np.searchsorted(other.trajectory[order], own.trajectory).clip(max=len(other) - 1)
    rows = order[place]
    return np.where(other.trajectory[rows] == own.trajectory, rows, -1)


def _write_targets(
    folder: Path, own: TrackTable, cameras: Sequence[CameraModel], number: int
) -> I64:
    """Write projections of particles as targets, sorted by row as OpenPTV needs.

    Returns each particle's target in each camera (n, camera); -1 where the camera does not see it.
    """
    found = np.full((len(own), len(cameras)), -1)
    grey = np.full(len(own), 100.0) if own.intensity is None else own.intensity
    for column, camera in enumerate(cameras):
        pixels, valid = camera.project(own.position_mm)
        seen = np.flatnonzero(valid & camera.contains(pixels))
        seen = seen[np.argsort(pixels[seen, 1], kind="stable")]
        found[seen, column] = np.arange(len(seen))
        lines = [
            f"{n:4d} {x + 0.5:9.4f} {y + 0.5:9.4f} {_SIDE**2:5d} {_SIDE:5d} {_SIDE:5d} "
            f"{max(1, round(grey[row])):5d} {row:5d}"
            for n, ((x, y), row) in enumerate(
                zip(pixels[seen].tolist(), seen.tolist(), strict=True)
            )
        ]
        _write(folder / "img" / f"cam{column + 1}.{number}_targets", lines)
    return found
