"""Cameras (Tsai's model, extended Zolof polynomials) and results of MyPTV.

Source: the formats as MyPTV 1.3 documents and writes them. The camera's axes are the rows of
R = Rx Ry Rz. A pixel (column, row) of a Tsai camera sees along ((c, r, f) + E Z) R, where c and r
count from the image's centre and Z are column, row, column^2, row^2 and column row. Pixel (0, 0) is
the centre of the first pixel. A Zolof camera gives column and row as cubic polynomials of X, Y, Z;
of its lines of sight, the file's own approximation is not used.

Columns of results, apart by tabs: of particles x y z, a blob of each camera (-1: none), error,
frame; of trajectories the same behind the number (-1: none); of smoothed ones number, x y z,
velocity, acceleration (both per frame), frame; of blobs column, row, size along both, area, frame.
Newer versions keep the same columns in the data set `dataset` of an HDF5 file.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.central_camera import image_lattice
from sabench.geometry.lens import Distortion
from sabench.geometry.polynomial_cameras import Soloff
from sabench.interop import foreign, lenses
from sabench.utils.arrays import F64, I64, nested
from sabench.utils.errors import InputError
from sabench.utils.tables import content_lines, read_table, split_numbers

LOST_OF_CAMERAS = ("f-numbers and focal lengths", "the pixel pitch")
_TSAI, _ZOLOF = "tsai", "extendedzolof"
_OLD_NAME = re.compile(r"cam(era)?_?\d+")  # names of files without a line of the model
# powers of X, Y, Z of the coefficients A; older files have the first 17
_POWERS = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2),
    (1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1), (1, 2, 0), (1, 0, 2), (2, 1, 0),
    (0, 1, 2), (2, 0, 1), (0, 2, 1), (3, 0, 0), (0, 3, 0),
)  # fmt: skip


def read_cameras(path: Path, extent: lenses.Extent) -> list[CameraModel]:
    """Read one camera file, or all files of a folder that begin as camera files do.

    Raises InputError for a missing camera file, or a broken one.
    """
    files = sorted(path.iterdir()) if path.is_dir() else []
    old = [file for file in files if _OLD_NAME.fullmatch(file.name) and file.is_file()]
    paths = [file for file in files if _is_camera(file)] or old if path.is_dir() else [path]
    if not paths:
        raise InputError(f"{path}: expected camera files of MyPTV, found none")
    return [_read_camera(file, extent) for file in paths]


def _is_camera(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(40).decode("latin-1").lower()
    return head.startswith((_TSAI, _ZOLOF))


def _read_camera(path: Path, extent: lenses.Extent) -> CameraModel:
    lines = content_lines(path)
    model = lines[0][1].split()[0].lower() if lines else ""
    if model == _ZOLOF:
        return _read_zolof(path, lines[1:], extent)
    first = 1 if model == _TSAI else 0  # files before 1.0 have no line of the model
    return _read_tsai(path, lines[first:], extent, has_size=model == _TSAI)


def _read_tsai(
    path: Path, lines: Sequence[tuple[int, str]], extent: lenses.Extent, *, has_size: bool
) -> CameraModel:
    counts = (2,) * has_size + (3, 3, 1, 2, 5, 5, 5)
    if len(lines) < len(counts) + 1:
        raise InputError(
            f"{path}: expected a name and {len(counts)} lines of numbers, got {len(lines)} lines"
        )
    rows = [
        np.array(split_numbers(text, f"{path}: line {number}", count))
        for (number, text), count in zip(lines[1:], counts, strict=False)
    ]
    columns, height = rows.pop(0).astype(int) if has_size else extent.image(str(path))[::-1]
    center, angles, (focal,), offset = rows[:4]
    lenses.check_positive(str(path), "image size and focal length", columns, height, focal)
    pose = lenses.StoredCamera(
        _name(lines[0][1]), int(height), int(columns), center, _rotation(angles), str(path)
    )
    middle = np.array([columns, height]) / 2.0 + offset
    correction = np.stack(rows[4:7])
    if not correction.any():
        column, row = middle
        return lenses.plain_camera(
            pose, focal, (float(column), float(row)), Distortion(), lenses.PIXEL_MM
        )
    pixels = image_lattice(pose.rows, pose.columns)
    x, y = pixels.T
    terms = np.stack([x, y, x**2, y**2, x * y], axis=1)
    along = np.column_stack([pixels - middle, np.full(len(pixels), focal)]) + terms @ correction.T
    return lenses.camera_of_pairs(pose, np.asarray(along[:, :2] / along[:, 2:]), pixels, focal)


def _name(text: str) -> str:
    return "".join(mark if mark.isalnum() else "_" for mark in text) or "camera"


def _rotation(angles: F64) -> F64:
    (a, b, c), (d, e, f) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -d], [0.0, d, a]])
    about_y = np.array([[b, 0.0, e], [0.0, 1.0, 0.0], [-e, 0.0, b]])
    about_z = np.array([[c, -f, 0.0], [f, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_x @ about_y @ about_z)


def _read_zolof(path: Path, lines: Sequence[tuple[int, str]], extent: lenses.Extent) -> CameraModel:
    """Read the polynomials of column and row, which are a Soloff camera's."""
    table = np.full((len(_POWERS), 2), np.nan)
    for number, text in lines[1:]:
        words = text.split()
        if words[0] == "A":
            term, side, value = split_numbers(" ".join(words[1:]), f"{path}: line {number}", 3)
            if not (0 <= term < len(_POWERS) and side in (0, 1)):
                raise InputError(f"{path}: line {number}: expected A of 0 to 18 and 0 or 1")
            table[int(term), int(side)] = value
    if np.isnan(table[:17]).any():
        raise InputError(f"{path}: expected 17 or 19 coefficients A of column and row")
    # polynomials in the coordinates of the volume's box
    rows, columns = extent.image(str(path))
    if extent.low_mm is None or extent.high_mm is None:
        raise InputError(
            f"{path}: a polynomial camera needs the measured volume: give its corners (--volume)"
        )
    low, high = np.asarray(extent.low_mm), np.asarray(extent.high_mm)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    unit = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 4)] * 3), axis=-1).reshape(-1, 3)
    terms = _monomials(middle + unit * half)
    solution = np.linalg.lstsq(Soloff.terms(unit), terms @ np.nan_to_num(table), rcond=None)[0]
    coefficients = np.asarray(solution, dtype=np.float64)
    x, y, z = middle.tolist()
    a, b, c = half.tolist()
    return Soloff(_name(lines[0][1]), rows, columns, (x, y, z), (a, b, c), nested(coefficients.T))


def _monomials(points: F64) -> F64:
    return np.stack([np.prod(points**power, axis=1) for power in _POWERS], axis=1)


def write_cameras(
    folder: Path, cameras: Sequence[CameraModel], world: foreign.ForeignWorld, points_mm: F64 | None
) -> None:
    """Write a file for each camera, named as the camera.

    A pinhole in air without distortion has Tsai's model. Other cameras have polynomials, fitted
    over points (n, 3) of the volume; the error is said.

    Raises InputError for a camera that needs the volume, which is not given.
    """
    errors: dict[str, tuple[float, float]] = {}
    for camera in cameras:
        if isinstance(camera, Camera) and camera.wall is None and camera.distortion == Distortion():
            text = _tsai_text(camera.upright())
        elif points_mm is None:
            raise InputError(f"{camera.name}: MyPTV has polynomials for it: give the volume (grid)")
        else:
            text, errors[camera.name] = _zolof_text(camera, points_mm)
        (folder / camera.name).write_text(text, encoding="utf-8")
    if errors:
        error_px, error_mm = (max(column) for column in zip(*errors.values(), strict=True))
        foreign.note(
            f"myptv: polynomials replace {', '.join(errors)} in the volume; they differ by up to "
            f"{error_px:.2g} px, and their lines of sight by up to {error_mm:.2g} mm"
        )


def _tsai_text(camera: Camera) -> str:
    offset = np.asarray(camera.principal_point_px) - [camera.columns / 2.0, camera.rows / 2.0]
    rotation = np.asarray(camera.rotation)
    rows = [
        (camera.columns, camera.rows),
        camera.center_mm,
        np.array(
            [
                np.arctan2(-rotation[1, 2], rotation[2, 2]),
                np.arcsin(np.clip(rotation[0, 2], -1.0, 1.0)),
                np.arctan2(-rotation[0, 1], rotation[0, 0]),
            ]
        ).tolist(),
        (camera.focal_px,),
        offset.tolist(),
        *[[0.0] * 5] * 3,
    ]
    # its own reader drops the last two characters of a line
    text = [" ".join(repr(value) for value in row) + " " for row in rows]
    return "\n".join(["Tsai model camera", camera.name, *text]) + "\n"


def _zolof_text(camera: CameraModel, points_mm: F64) -> tuple[str, tuple[float, float]]:
    """Fit the polynomials of pixels A, and of lines of sight B through a point O.

    Also returns the largest errors of both, in px and mm.
    """
    pixels, valid = camera.project(points_mm)
    points, pixels = points_mm[valid], pixels[valid]
    table, error_px = _least_squares(_monomials(points), pixels)
    rays = camera.back_project(pixels)
    across = np.eye(3) - rays.directions[:, :, None] * rays.directions[:, None, :]
    beside = np.einsum("nij,nj->i", across, rays.origins_mm)
    origin = np.linalg.solve(across.sum(axis=0), beside)
    towards = points - origin
    away = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    x, y = pixels.T
    lines, error = _least_squares(
        np.stack([x**0, x, y, x**2, y**2, x * y, x**2 * y, x * y**2, x**3, y**3], axis=1), away
    )
    reach = float(np.linalg.norm(towards, axis=1).max())
    parts = [("O", origin[:, None]), ("A", table), ("B", lines)]
    rows = [
        f"{letter} {' '.join(map(str, index[: 1 if letter == 'O' else 2]))} \t {value!r} "
        for letter, values in parts
        for index, value in zip(np.ndindex(values.shape), values.ravel().tolist(), strict=True)
    ]
    text = "\n".join(["extendedZolof model camera", camera.name, *rows]) + "\n"
    return text, (error_px, error * reach)


def _least_squares(terms: F64, values: F64) -> tuple[F64, float]:
    """Solve for coefficients; also return the largest error."""
    scale = np.abs(terms).max(axis=0)
    solution = np.linalg.lstsq(terms / scale, values, rcond=None)[0] / scale[:, None]
    return np.asarray(solution), float(np.abs(terms @ solution - values).max())


LOST_OF_TRACKS = ("intensities of particles", "sizes of blobs (they are 3 x 3 pixels)")
_NAMES = ("smoothed_trajectories", "trajectories", "particles")
_SMOOTHED = 11  # columns


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> foreign.TrackTable:
    """Read particles, trajectories or smoothed trajectories of a file or folder.

    Raises InputError for a missing file, or a broken one; velocities without the time between
    frames.
    """
    file = _file(path)
    values = _values(file)
    factor = 1.0 if unit is None else foreign.unit_mm(unit)
    frame = _whole(file, values[:, -1], "frame")
    if not _is_whole(values[:, 0]):
        foreign.note(f"{file}: its particles have no trajectories")
        return foreign.TrackTable(frame, values[:, :3] * factor).sorted()
    number = foreign.number_strangers(values[:, 0].astype(np.int64))
    rates: dict[str, F64] = {}
    # else whole numbers: blobs of cameras
    if values.shape[1] == _SMOOTHED and not _is_whole(values[:, 4:9]):
        if interval_s is None:
            raise InputError(f"{file}: velocities are per frame: give the time between frames")
        rates["velocity_mm_s"] = values[:, 4:7] * factor / interval_s
        rates["acceleration_mm_s2"] = values[:, 7:10] * factor / interval_s**2
    return foreign.TrackTable(frame, values[:, 1:4] * factor, number, **rates).sorted()


def _file(path: Path) -> Path:
    names = [name + ending for name in _NAMES for ending in ("", ".txt", ".hdf5")]
    file = next((path / name for name in names if (path / name).is_file()), path)
    if not file.is_file():
        raise InputError(
            f"{path}: expected a file smoothed_trajectories, trajectories or particles, found none"
        )
    return file


def _values(file: Path) -> F64:
    if h5py.is_hdf5(file):
        with open_hdf5(file) as opened:
            values = read_array(opened, "dataset", (None, None), "fiu").astype(np.float64)
        if values.shape[1] < 5 or not np.isfinite(values).all():
            raise InputError(f"{file}: dataset: expected 5 or more columns of finite numbers")
        return np.asarray(values)
    return read_table(file, 5).values


def _is_whole(values: F64) -> bool:
    return bool((values == np.rint(values)).all())


def _whole(file: Path, values: F64, what: str) -> I64:
    if not _is_whole(values):
        wrong = values[values != np.rint(values)][0]
        raise InputError(f"{file}: last column: expected numbers of a {what}, got {wrong:g}")
    return values.astype(np.int64)


def write_tracks(folder: Path, table: foreign.TrackTable, recording: foreign.Recording) -> None:
    """Write blobs, particles and trajectories; smoothed ones with velocities."""
    interval_s = recording.interval_s
    # blobs of each particle (n, camera) count from 0 in each frame; -1 where a camera does not
    # see it
    blobs = np.full((len(table), len(recording.cameras)), -1.0)
    for column, camera in enumerate(recording.cameras):
        pixels, valid = camera.project(table.position_mm)
        visible = np.flatnonzero(valid & camera.contains(pixels))
        frame = table.frame[visible]
        first = np.searchsorted(frame, frame)
        blobs[visible, column] = np.arange(len(visible)) - first
        size = np.tile([foreign.BLOB_PX, foreign.BLOB_PX, foreign.BLOB_PX**2], (len(visible), 1))
        _write(folder / f"blobs_cam{column + 1}", np.column_stack([pixels[visible], size, frame]))
    tail = np.column_stack([blobs, np.zeros(len(table)), table.frame])
    _write(folder / "particles", np.column_stack([table.position_mm, tail]))
    if table.trajectory is None:
        return
    head = np.column_stack([table.trajectory, table.position_mm])
    _write(folder / "trajectories", np.column_stack([head, tail]))
    if table.velocity_mm_s is not None:
        rates = table.velocity_mm_s * interval_s
        bend = table.acceleration_mm_s2
        change = np.zeros_like(rates) if bend is None else bend * interval_s**2
        columns = np.column_stack([head, rates, change, table.frame])
        _write(folder / "smoothed_trajectories", columns)


def _write(path: Path, rows: F64) -> None:
    """Write numbers, whole ones without a point."""
    lines = (
        "\t".join(str(int(value)) if value.is_integer() else repr(value) for value in row)
        for row in rows.tolist()
    )
    path.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
