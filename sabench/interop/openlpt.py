"""OpenLPT (https://github.com/JHU-NI-LAB/OpenLPT_GUI): files in and out.

Written are camera files, images and settings; read are the tracks that it finds.

Its world is that of the data set, in mm. A camera in air is its PINHOLE, with OpenCV's distortion;
one behind a wall is its PINPLATE: a pinhole and parallel plates of given thicknesses and indices,
listed from the fluid to the camera, with a point on the face to the fluid and the normal into it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tifffile

from sabench.api import FoundParticles
from sabench.geometry.camera import Camera
from sabench.geometry.grid import Grid
from sabench.geometry.lens import UPRIGHT
from sabench.geometry.refraction import Wall
from sabench.interop.foreign import BRIGHT, WHITE, Recording, TrackTable, to_8_bits
from sabench.interop.named_columns import table_of_columns
from sabench.utils.arrays import F32, F64
from sabench.utils.errors import InputError
from sabench.utils.processes import python
from sabench.utils.tables import UnitArray, read_table

if TYPE_CHECKING:
    from sabench.interop.image_statistics import FrameStatistics


LEAST_FRAMES = 5  # needed to estimate the optical transfer function
_TOLERANCE, _ITERATIONS, _RATE = 1e-9, 1000, 0.1  # settings of its projection through plates
_SKIN_MM = 1e-3  # thickness of fluid in place of a plate where a wall has none


@dataclass(frozen=True)
class Settings:
    """Parameters of OpenLPT, lengths in mm; defaults are those of its window.

    Attributes
    ----------
    threshold : smallest peak, of 255.
    radius_px : of a particle's image.
    move_mm : largest displacement from frame to frame about the mean one of a neighbourhood.
    spacing_mm : distance of neighbouring particles, and of the nodes of the field of displacements.
    reach_mm : radius of the particles averaged at these nodes.
    tolerance_px, tolerance_mm : tolerances of intersections of lines of sight.
    mm_per_px : at the centre of the volume.
    threads : 0 for all.
    """

    threshold: int
    radius_px: float
    move_mm: float
    spacing_mm: float
    reach_mm: float
    tolerance_px: float
    tolerance_mm: float
    mm_per_px: float
    shake_px: float = 0.25
    ghost: float = 0.01
    rounds: int = 4
    fits: int = 4
    threads: int = 1


def derive_settings(
    seen: FrameStatistics,
    displacement_px: float = 10.0,
    tolerance_px: float = 0.8,
    floor: float = 0.2,
) -> Settings:
    """Derive settings from the statistics of the first frame.

    Parameters
    ----------
    displacement_px : largest displacement from frame to frame.
    tolerance_px : largest distance of a particle image from its particle's projection.
    floor : smallest peak of a particle image, over a bright particle's; more if noise demands it.
    """
    return Settings(
        threshold=round(BRIGHT * max(floor, seen.floor)),
        radius_px=2.5 * seen.sigma_px,
        move_mm=0.5 * displacement_px * seen.mm_per_px,
        spacing_mm=seen.spacing_mm,
        reach_mm=max(displacement_px * seen.mm_per_px, seen.spacing_mm),
        tolerance_px=tolerance_px,
        tolerance_mm=tolerance_px * seen.mm_per_px,
        mm_per_px=seen.mm_per_px,
    )


def camera_text(camera: Camera) -> str:
    """Format a camera file; raises ValueError for a camera that is `unfit`."""
    reason = unfit(camera)
    if reason:
        raise ValueError(f"{camera.name}: {reason}")
    camera = camera.upright()
    rotation = np.asarray(camera.rotation)
    center = np.asarray(camera.center_mm)
    focal, lens = camera.principal_distance_mm / camera.pixel_mm, camera.distortion
    across, down = camera.principal_point_px
    wall = camera.wall if isinstance(camera.wall, Wall) else None
    bends = wall is not None and len(set(wall.indices)) > 1
    matrix = np.array([[focal, 0.0, across], [0.0, focal, down], [0.0, 0.0, 1.0]])
    parts = {
        "Camera Model": "PINPLATE" if bends else "PINHOLE",
        "Camera Calibration Error": "None",
        "Pose Calibration Error": "None",
        "Image Size: (n_row,n_col)": f"{camera.rows},{camera.columns}",
        "Camera Matrix": _rows(matrix),
        "Distortion Coefficients": _row([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]),
        "Rotation Vector": "0,0,0",
        "Rotation Matrix": _rows(rotation),
        "Inverse of Rotation Matrix": _rows(rotation.T),
        "Translation Vector": _row(-rotation @ center),
        "Inverse of Translation Vector": _row(center),
    }
    parts |= _plates(wall) if wall and bends else {}
    return "".join(f"# {name}\n{text}\n" for name, text in parts.items())


def missing() -> str | None:
    """Return how to install the program; None if it is installed."""
    return python.missing_package("pyopenlpt", "openlpt")


def unfit(camera: Camera) -> str | None:
    """Return why OpenLPT cannot describe a camera; None if it can."""
    if camera.wall and not isinstance(camera.wall, Wall):
        return "OpenLPT supports plane walls, and this wall is a cylinder"
    lens = camera.distortion
    coefficients = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    if coefficients.any() and coefficients.max() <= 0.0:
        return "OpenLPT ignores a distortion without a positive coefficient"
    if coefficients.any() and camera.tilt_deg != UPRIGHT:
        return "OpenLPT has no tilted sensor behind a lens with distortion"
    return None


def _plates(wall: Wall) -> dict[str, str]:
    thick, indices = [layer.thickness_mm for layer in wall.layers], tuple(wall.indices)
    if not thick:  # OpenLPT needs a plate; one of fluid has no effect
        thick, indices = [_SKIN_MM], (*indices, wall.fluid_index)
    normal = np.asarray(wall.normal)
    inner = np.asarray(wall.point_mm) + normal * sum(thick)
    return {
        "Reference point of the refractive plate": _row(inner),
        "Normal vector, from the cameras to the objects": _row(normal),
        "Refractive indices, from the objects to the cameras": _row(indices[::-1]),
        "Widths": _row(thick[::-1]),
        "Tolerance of the projection": repr(_TOLERANCE),
        "Its largest number of iterations": str(_ITERATIONS),
        "Its rate": repr(_RATE),
    }


def _row(values: Iterable[float]) -> str:
    return ",".join(repr(float(value)) for value in values)


def _rows(matrix: F64) -> str:
    return "\n".join(_row(row) for row in matrix)


def write_frame(folder: Path, frame: int, images: F32) -> None:
    """Write images (camera, row, column) as 8-bit TIFF; bright particles' peak is 1."""
    for camera, image in enumerate(images):
        path = folder / f"cam{camera}" / f"{frame:05d}.tif"
        path.parent.mkdir(exist_ok=True)
        tifffile.imwrite(path, to_8_bits(image))


def write_project(
    folder: Path,
    cameras: tuple[Camera, ...],
    grid: Grid,
    frames: int,
    settings: Settings,
    home: Path | None = None,
) -> None:
    """Write cameras, lists of images and settings into the folder of the images.

    `config.txt` names all of them, by their paths below `home`, where the folder will be.
    """
    home = home or folder
    for number, camera in enumerate(cameras):
        (folder / f"cam{number}.txt").write_text(camera_text(camera), encoding="utf-8")
        names = [f"{home}/cam{number}/{frame:05d}.tif\n" for frame in range(frames)]
        (folder / f"cam{number}ImageNames.txt").write_text("".join(names), encoding="utf-8")
    ends = np.column_stack(grid.centers_mm(1.0))
    count = len(cameras)
    lines = [f"0,{frames - 1}", "1", str(settings.threads), str(count)]
    lines += [f"{home}/cam{number}.txt,{WHITE}" for number in range(count)]
    lines += [f"{home}/cam{number}ImageNames.txt" for number in range(count)]
    lines += [_row(ends.ravel()), repr(settings.mm_per_px), f"{home}/results/"]
    lines += ["Tracer", f"{home}/tracer.txt", "0,0"]
    (folder / "config.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "tracer.txt").write_text("\n".join(_tracer(settings, ends)) + "\n", encoding="utf-8")


def _tracer(settings: Settings, ends: F64) -> list[str]:
    """Format the settings for tracer particles; OpenLPT's voxel is a pixel."""
    nodes = np.clip(np.ceil(np.ptp(ends, axis=1) / settings.spacing_mm), 3, 51).astype(int)
    voxel = settings.mm_per_px
    return [
        f"{settings.move_mm / voxel} # radius in which tracks look for particles at the start",
        "4 # frames of the start",
        f"{settings.spacing_mm / voxel} # spacing of particles",
        f"{settings.shake_px} # shake width",
        *(f"{node} # nodes of the field of displacements" for node in nodes),
        f"{settings.reach_mm / voxel} # radius around them",
        f"{settings.rounds} # rounds of reconstruction",
        f"{settings.fits} # rounds of shaking",
        f"{settings.ghost} # ghost threshold",
        f"{settings.tolerance_px} # px",
        f"{settings.tolerance_mm / voxel} # voxels",
        "1 # cameras that may be left out",
        "2 # rounds for each",
        f"{settings.threshold} # smallest peak",
        f"{settings.radius_px} # px",
    ]


def read_result(folder: Path, frames: int) -> list[FoundParticles]:
    """Read the particles of every frame from OpenLPT's files of tracks."""
    table = read_files(track_files(folder), None)
    parts = [table.of_frame(frame) for frame in range(frames)]
    return [FoundParticles(part.position_mm, trajectory=part.trajectory) for part in parts]


def solve(folder: Path, frames: int) -> list[FoundParticles]:
    """Run OpenLPT on a project folder, without tracking if below `LEAST_FRAMES`."""
    python.run_module(
        "sabench.interop.openlpt_process", folder, "OpenLPT", "Total time for frame", frames
    )
    if frames >= LEAST_FRAMES:
        return read_result(folder, frames)
    files = (folder / f"found_{frame:05d}.txt" for frame in range(frames))
    return [FoundParticles(np.loadtxt(file, ndmin=2).reshape(-1, 3)) for file in files]


# files that OpenLPT's own programs read as the result
_KINDS = ("LongTrackActive", "LongTrackInactive", "ExitTrack")
_HEAD = ("TrackID", "FrameID", "WorldX", "WorldY", "WorldZ")
LOST_OF_TRACKS = ("intensities, velocities and accelerations",)


def track_files(path: Path) -> list[Path]:
    """List the files of tracks of a result folder or of the folder above it."""
    if not path.is_dir():
        return [path]
    places = (path / "results" / "ConvergeTrack", path / "ConvergeTrack", path)
    folder = next((place for place in places if place.is_dir()), path)
    return [file for kind in _KINDS for file in sorted(folder.glob(f"{kind}_*.csv"))]


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read all tracks of a result; raises InputError for a missing or broken file."""
    files = track_files(path)
    if not files:
        raise InputError(f"{path}: expected files of tracks, ConvergeTrack/*_*.csv, found none")
    return read_files(files, unit)


def read_files(files: Sequence[Path], unit: str | None) -> TrackTable:
    """Read files of tracks; numbers of a file follow those of the file before."""
    none = np.zeros(0, dtype=np.int64)
    frame, position, number = [none], [np.zeros((0, 3))], [none]
    before = 0
    for file in files:
        part = _read_file(file, unit)
        shifted = np.asarray(part.trajectory) + before
        before = int(shifted.max(initial=before - 1)) + 1
        frame.append(part.frame)
        position.append(part.position_mm)
        number.append(shifted)
    numbers, tracks = np.concatenate(frame), np.concatenate(number)
    return TrackTable(numbers, np.concatenate(position), tracks).sorted()


def _read_file(file: Path, unit: str | None) -> TrackTable:
    """Read columns by names; pixels of cameras, which follow, are left out."""
    table = read_table(file, 5)
    names = [name.strip() for name in table.names]
    if not len(table.values):
        none = np.zeros(0, dtype=np.int64)
        return TrackTable(none, np.zeros((0, 3)), none)
    missing = next((name for name in _HEAD if name not in names), None)
    if missing:
        raise InputError(
            f"{file}: expected a column {missing}, got {', '.join(names) or 'no names'}"
        )
    columns = {name: UnitArray(table.values[:, names.index(name)], None) for name in _HEAD}
    return table_of_columns(str(file), columns, unit)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write all tracks into LongTrackActive_N.csv, N the last frame."""
    place = folder / "results" / "ConvergeTrack"
    place.mkdir(parents=True)
    number = np.arange(len(table)) if table.trajectory is None else table.trajectory
    rows = zip(number.tolist(), table.frame.tolist(), table.position_mm.tolist(), strict=True)
    lines = [",".join(_HEAD)]
    lines += [f"{track},{frame},{x!r},{y!r},{z!r}" for track, frame, (x, y, z) in rows]
    last = int(table.frame.max(initial=0))
    file = place / f"LongTrackActive_{last}.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
