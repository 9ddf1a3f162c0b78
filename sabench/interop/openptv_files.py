"""Files of an OpenPTV project: cameras, settings and results.

Cameras are in ptv.par and .ori and .addpar files.

Source: the formats as the library optv 0.3.2 reads them. Its world is kept as it is. Positions on
the sensor are in mm, X to the right and Y up from the image's centre, and the distortion acts about
that centre. The wall is one plane-parallel layer.

ptv_is: the number of particles, then for each the rows in the frame before (-1: none) and after
(-2: none), and X Y Z. rt_is: the number, then a count from 1, X Y Z and the targets of four
cameras (-1: none). Targets: the number, then for each a count from 0, column and row (the centre of
the first pixel is 0.5, 0.5), pixels in all, along X and along Y, their sum of grey values, and the
row in rt_is (-1: none).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.lens import Distortion, distort
from sabench.geometry.refraction import Layer, Wall
from sabench.interop import lenses, openptv
from sabench.interop.foreign import BLOB_PX, ForeignWorld, Recording, TrackTable, note, unit_mm
from sabench.interop.openptv import join_links
from sabench.utils.arrays import F64, I64, triple
from sabench.utils.errors import InputError
from sabench.utils.tables import content_lines, numbered_files, read_table, split_numbers

_SUFFIXES = (".ori", ".addpar")
LOST_OF_CAMERAS = (
    "f-numbers and focal lengths",
    "the depth of the tank",
    "names of cameras (they are cam1, cam2 ...)",
)


@dataclass(frozen=True)
class _Control:
    """Contents of ptv.par."""

    path: Path
    names: tuple[str, ...]
    columns: int
    rows: int
    pixel_mm: tuple[float, float]
    indices: tuple[float, float, float]  # air, glass, fluid
    thickness_mm: float


def read_cameras(path: Path, extent: lenses.Extent) -> list[CameraModel]:
    """Read the cameras of a project folder, or of a file ptv.par in it.

    Raises InputError for a file that is missing or broken.
    """
    file = _find_control(path)
    lines = content_lines(file)
    count = int(_number(file, lines, 0))
    if not 1 <= count <= 64 or len(lines) < 2 * count + 12:
        raise InputError(
            f"{file}: line 1: expected the number of cameras and {2 * count + 11} lines more, got "
            f"{lines[0][1] if lines else 'nothing'!r} and {len(lines) - 1}"
        )
    names = tuple(lines[2 + 2 * i][1] for i in range(count))
    first = 2 * count + 4
    columns, rows, across, along, _, air, glass, fluid, thick = (
        _number(file, lines, first + i) for i in range(9)
    )
    lenses.check_positive(str(file), "image size and pixel pitch", columns, rows, across, along)
    lenses.check_positive(str(file), "refractive index", air, glass, fluid)
    control = _Control(
        file, names, int(columns), int(rows), (across, along), (air, glass, fluid), thick
    )
    folder = control.path.parent
    root = folder.parent if folder.name.startswith("parameters") else folder
    lenses.check_media(str(control.path), control.indices)
    return [_read_camera(root, name, control) for name in control.names]


def _find_control(path: Path) -> Path:
    if path.is_file():
        return path
    places = [path / "parameters" / "ptv.par", path / "ptv.par"]
    control = next((place for place in places if place.is_file()), None)
    if control is None:
        raise InputError(f"{path}: expected an OpenPTV project with parameters/ptv.par, found none")
    return control


def _number(path: Path, lines: Sequence[tuple[int, str]], index: int) -> float:
    if index >= len(lines):
        raise InputError(f"{path}: expected {index + 1} lines or more, got {len(lines)}")
    number, text = lines[index]
    return split_numbers(text.split()[0], f"{path}: line {number}", 1)[0]


def _read_camera(root: Path, name: str, control: _Control) -> CameraModel:
    path = root / f"{name}.ori"
    if not path.is_file():
        raise InputError(f"{path}: expected the orientation of the camera {name}, found no file")
    lines = content_lines(path)
    counts = (3, 3, 3, 3, 3, 2, 1, 3)
    if len(lines) < len(counts):
        raise InputError(f"{path}: expected {len(counts)} lines with numbers, got {len(lines)}")
    rows = [
        np.array(split_numbers(text, f"{path}: line {number}", count))
        for (number, text), count in zip(lines, counts, strict=False)
    ]
    position, turned = rows[0], np.stack(rows[2:5])
    (across, above), (distance,), glass = rows[5:8]
    lenses.check_positive(str(path), "principal distance", distance)
    rotation = np.stack([turned[:, 0], -turned[:, 1], -turned[:, 2]])
    wall = _wall(path, control, glass, position)
    plain = Path(name).name.split(".")[0]
    pose = lenses.StoredCamera(
        plain, control.rows, control.columns, position, rotation, str(path), wall
    )
    addpar = _read_distortion(root / f"{name}.addpar")
    return _camera(pose, control, distance, np.array([across, above]), addpar)


def _read_distortion(path: Path) -> F64:
    """Read k1 k2 k3 p1 p2, scale and shear; without a file there is none."""
    if not path.is_file():
        note(f"{path}: found no file, so that the camera has no distortion")
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    text = " ".join(line for _, line in content_lines(path))
    return np.array(split_numbers(text, str(path), 7))


def _wall(path: Path, control: _Control, glass: F64, position: F64) -> Wall | None:
    air, index, fluid = control.indices
    if air == index == fluid:
        return None
    distance = float(np.linalg.norm(glass))
    if not distance > 0.0:
        raise InputError(f"{path}: glass: expected a vector to the glass, got one of length 0")
    out = glass / distance
    if control.thickness_mm < 0.0 or position @ out <= distance + control.thickness_mm:
        raise InputError(
            f"{path}: glass: expected the camera before its glass, which begins "
            f"{distance + control.thickness_mm:g} mm from the origin, got it at "
            f"{position @ out:g} mm"
        )
    layers = (Layer("glass", index, control.thickness_mm),) if control.thickness_mm else ()
    point = glass + out * control.thickness_mm
    return Wall(triple(point), triple(-out), air, layers, fluid)


def _camera(
    pose: lenses.StoredCamera, control: _Control, distance: float, offset: F64, addpar: F64
) -> CameraModel:
    """Make a `Camera` if it has such a lens, else a central camera."""
    k1, k2, k3, p1, p2, scale, shear = addpar.tolist()
    b, (across, along) = distance, control.pixel_mm
    middle = np.array([control.columns - 1, control.rows - 1]) / 2.0
    lens = Distortion(k1 * b**2, k2 * b**4, -p2 * b, p1 * b, k3 * b**6)
    plain = lens == Distortion() or not offset.any()
    if plain and across == along and shear == 0.0:
        column, row = middle + scale * offset * [1.0, -1.0] / across
        focal = scale * b / across
        return lenses.plain_camera(pose, focal, (float(column), float(row)), lens, across)

    def project(ideal: F64) -> F64:
        start = ideal * [1.0, -1.0] * b + offset
        bent, _, _ = distort(lens, start * [1.0, -1.0] / b)
        x, y = (bent * [1.0, -1.0] * b).T
        turned = scale * np.column_stack([x - np.sin(shear) * y, np.cos(shear) * y])
        return np.asarray(middle + turned * [1.0, -1.0] / control.pixel_mm)

    note(
        f"{pose.where}: its distortion about the image's centre, or its pixels, are not those of a "
        "camera of the kind `pinhole`: it is `central`"
    )
    return lenses.camera_of_lens(pose, project, b / across)


def unfit(cameras: Sequence[CameraModel]) -> str | None:
    """Return why OpenPTV cannot describe cameras; None if it can."""
    odd = next((camera.name for camera in cameras if not isinstance(camera, Camera)), None)
    if odd:
        return f"{odd}: OpenPTV has pinholes with Brown-Conrady's distortion only"
    plain = [camera for camera in cameras if isinstance(camera, Camera)]
    if len(plain) > openptv.MOST_CAMERAS:
        return f"OpenPTV has {openptv.MOST_CAMERAS} cameras at most, got {len(plain)}"
    faults = [f"{camera.name}: {why}" for camera in plain if (why := openptv.unfit(camera))]
    sizes = {(camera.rows, camera.columns) for camera in plain}
    if not faults and len(sizes) > 1:
        return f"OpenPTV has one size of images, and the cameras have {sorted(sizes)}"
    return faults[0] if faults else openptv.unlike(plain)


def write_cameras(
    folder: Path, cameras: Sequence[Camera], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write parameters/ptv.par and cal/cam1.ori, cal/cam1.addpar and so on."""
    (folder / "cal").mkdir()
    (folder / "parameters").mkdir()
    for number, camera in enumerate(cameras, 1):
        texts = (openptv.orientation_text(camera, world), openptv.distortion_text(camera))
        for suffix, text in zip(_SUFFIXES, texts, strict=True):
            path = folder / "cal" / f"cam{number}.tif{suffix}"
            path.write_text(text, encoding="utf-8")
    first, media = cameras[0], openptv.list_media(cameras[0])
    names = [
        name
        for number in range(1, len(cameras) + 1)
        for name in (f"img/cam{number}.10001", f"cal/cam{number}.tif")
    ]
    lines: list[object] = [
        len(cameras),
        *names,
        0,  # no high-pass filter
        0,  # particles that fewer than all cameras see, too
        1,  # images are TIFF files
        first.columns,
        first.rows,
        first.pixel_mm,
        first.pixel_mm,
        0,  # no field: full frames
        media["n1"],
        media["n2"][0],
        media["n3"],
        media["d"][0],
    ]
    text = "\n".join(str(line) for line in lines) + "\n"
    (folder / "parameters" / "ptv.par").write_text(text, encoding="utf-8")


def write_parameters(
    folder: Path,
    grid: Grid,
    cameras: Sequence[Camera],
    frames: Sequence[int],
    settings: openptv.Settings,
) -> None:
    """Write the files sequence, criteria, targ_rec and track.par of a project.

    They are of OpenPTV's world for the volume of a grid. `frames` are the first and last numbers.
    """
    low, high = openptv.ends_mm(grid, openptv.world_of(grid))
    band_mm = settings.tolerance_px * cameras[0].pixel_mm
    move, change, bright = settings.move_mm, settings.change_mm, settings.threshold
    files = {
        "sequence": [*(f"img/cam{number}." for number in range(1, len(cameras) + 1)), *frames],
        # the volume at its left and right ends, similarity of targets, band on the sensor
        "criteria": [low[0], low[2], high[2], high[0], low[2], high[2], *4 * [0.01], 0, band_mm],
        # thresholds, discontinuity, least and most pixels in all, along X and Y, sum of grey
        "targ_rec": [*4 * [bright], settings.discontinuity, 2, 400, 1, 40, 1, 40, bright, 2],
        "track": [*3 * [-move, move], settings.angle_gon, change, 0],
    }
    for name, lines in files.items():
        text = "".join(f"{line}\n" for line in lines)
        (folder / "parameters" / f"{name}.par").write_text(text, encoding="utf-8")


FIRST = 10001  # number of our frame 0 in the names of files
LOST_OF_TRACKS = (
    "intensities, velocities and accelerations of particles",
    "sizes of targets (they are 3 x 3 pixels)",
)


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read the frames of a folder, of `res` in it, or of the folder of a file.

    Links are read from ptv_is files; without them, particles from rt_is files.

    Raises InputError for a missing file, or a broken one.
    """
    places = [path / "res", path] if path.is_dir() else [path.parent]
    series = [
        (kind, files)
        for place in places
        if place.is_dir()
        for kind in ("ptv_is", "rt_is")
        if (files := list(numbered_files(place, rf"{kind}\.(?P<frame>\d+)")))
    ]
    if not series:
        raise InputError(f"{path}: expected files ptv_is.N or rt_is.N, in it or in res, found none")
    kind, files = series[0]
    if kind == "rt_is":
        note(f"{path}: found no ptv_is files: the particles have no trajectories")
    first = 2 if kind == "ptv_is" else 1
    tables = [_read_frame(file, 5 if kind == "ptv_is" else 4) for _, file in files]
    counts = [len(table) for table in tables]
    factor = 1.0 if unit is None else unit_mm(unit)
    position = np.concatenate([table[:, first : first + 3] for table in tables]) * factor
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
    for frame, part in enumerate(parts):
        targets = _write_targets(folder, part, cameras, FIRST + frame)
        rows = np.full((len(part), openptv.MOST_CAMERAS), -1)
        rows[:, : len(cameras)] = targets[:, : openptv.MOST_CAMERAS]
        lines = [
            f"{n:4d} {x!r} {y!r} {z!r} " + " ".join(map(str, row))
            for n, ((x, y, z), row) in enumerate(
                zip(part.position_mm.tolist(), rows.tolist(), strict=True), 1
            )
        ]
        _write(folder / "res" / f"rt_is.{FIRST + frame}", lines)
    for frame, part in enumerate(parts):
        before = _rows_in(part, parts[frame - 1]) if frame else np.full(len(part), -1)
        after = _rows_in(part, parts[frame + 1]) if frame + 1 < frames else np.full(len(part), -1)
        after[after < 0] = -2
        lines = [
            f"{a:4d} {b:4d} {x!r} {y!r} {z!r}"
            for a, b, (x, y, z) in zip(
                before.tolist(), after.tolist(), part.position_mm.tolist(), strict=True
            )
        ]
        _write(folder / "res" / f"ptv_is.{FIRST + frame}", lines)


def _write(path: Path, lines: Sequence[str]) -> None:
    path.write_text("\n".join([str(len(lines)), *lines]) + "\n", encoding="utf-8")


def _rows_in(table: TrackTable, other: TrackTable) -> I64:
    """Find the rows of the same trajectories in another frame; -1 for none."""
    if table.trajectory is None or other.trajectory is None or not len(other):
        return np.full(len(table), -1)
    order = np.argsort(other.trajectory)
    place = np.searchsorted(other.trajectory[order], table.trajectory).clip(max=len(other) - 1)
    rows = order[place]
    return np.where(other.trajectory[rows] == table.trajectory, rows, -1)


def _write_targets(
    folder: Path, table: TrackTable, cameras: Sequence[CameraModel], number: int
) -> I64:
    """Write projections of particles as targets, sorted by row as OpenPTV needs.

    Returns each particle's target in each camera (n, camera); -1 where the camera does not see it.
    """
    targets = np.full((len(table), len(cameras)), -1)
    grey = np.full(len(table), 100.0) if table.intensity is None else table.intensity
    for column, camera in enumerate(cameras):
        pixels, valid = camera.project(table.position_mm)
        visible = np.flatnonzero(valid & camera.contains(pixels))
        visible = visible[np.argsort(pixels[visible, 1], kind="stable")]
        targets[visible, column] = np.arange(len(visible))
        lines = [
            f"{n:4d} {x + 0.5:9.4f} {y + 0.5:9.4f} {BLOB_PX**2:5d} {BLOB_PX:5d} {BLOB_PX:5d} "
            f"{max(1, round(grey[row])):5d} {row:5d}"
            for n, ((x, y), row) in enumerate(
                zip(pixels[visible].tolist(), visible.tolist(), strict=True)
            )
        ]
        _write(folder / "img" / f"cam{column + 1}.{number}_targets", lines)
    return targets
