"""Point lists and particle files of the challenges on particle tracking.

Cameras are lists of points: X Y Z and the pixels x1 y1 x2 y2 ... of all. Pixel (0, 0) is the centre
of the first pixel. The reader fits a model to each camera; a camera that does not see a point has
NaN.

Particles have one file for each frame, with the number at the end of its name. Three lines of
Tecplot's head (title, variables, zone) come before X Y Z in mm and, where particles are tracked,
their number. Files without the head are read, too.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import rq

from sabench.geometry.camera_model import CameraModel
from sabench.geometry.lens import Distortion
from sabench.geometry.polynomial_cameras import fit_soloff
from sabench.geometry.projective_camera import Projective, fit_projective
from sabench.interop.foreign import ForeignWorld, Recording, TrackTable, note, unit_mm
from sabench.interop.lenses import PIXEL_MM, Extent, StoredCamera, plain_camera
from sabench.interop.named_columns import table_of_columns
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.utils.tables import UnitArray, content_lines, numbered_files, read_table

LOST_OF_CAMERAS = (
    "f-numbers and focal lengths",
    "the pixel pitch",
    "walls: the points show their effect",
)
_FILE = "CalibPoints.txt"
_HELD = 3  # every third point is held out of the comparison of models
_SQUARE = 1e-4  # shear and difference of focal lengths of a fit that counts as square pixels
_NO_WORSE = 1.1  # largest ratio of errors that favours the simpler model


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Fit a pinhole or a Soloff polynomial to each camera of a point list.

    The model with the smaller error at held-out points is used, and a note gives its error.

    Raises InputError for a missing file, columns that are no pairs, too few points, or a missing
    size of the images.
    """
    file = path / _FILE if path.is_dir() else path
    table = read_table(file, 5, missing=True)
    values = table.values
    if values.shape[1] % 2 == 0:
        raise InputError(
            f"{file}: expected X Y Z and two columns for each camera, got {values.shape[1]} columns"
        )
    size = extent.image(str(file))
    count = (values.shape[1] - 3) // 2
    parts = [values[:, 3 + 2 * i : 5 + 2 * i] for i in range(count)]
    return [
        fit_camera(f"{file}: camera {i}", f"camera_{i:02d}", size, values[:, :3], pixels)
        for i, pixels in enumerate(parts)
    ]


def fit_camera(
    where: str, name: str, size: tuple[int, int], points_mm: F64, pixels: F64
) -> CameraModel:
    """Fit a camera to points (n, 3) and pixels (n, 2); rows with NaN are left out."""
    valid = np.isfinite(points_mm).all(axis=1) & np.isfinite(pixels).all(axis=1)
    points, image = points_mm[valid], pixels[valid]
    held = np.arange(len(points)) % _HELD == 0
    errors = {}
    for fit in (fit_projective, fit_soloff):
        try:
            trial = fit(name, *size, points[~held], image[~held])
            miss = trial.project(points[held])[0] - image[held]
            errors[fit] = float(np.sqrt(np.mean(miss**2)))
        except InputError as error:
            fault = error
    if not errors:
        raise InputError(f"{where}: {fault}")
    best = min(errors.values())
    chosen = next(fit for fit, error in errors.items() if error <= _NO_WORSE * best + 1e-9)
    fitted = chosen(name, *size, points, image)
    camera = (isinstance(fitted, Projective) and _pinhole(fitted, where)) or fitted
    note(
        f"{where}: fitted {type(camera).__name__} to {len(points)} points, error of points held "
        f"out {errors[chosen]:.2g} px"
    )
    return camera


def _pinhole(camera: Projective, where: str) -> CameraModel | None:
    """Decompose a projective camera into a pinhole; None without square pixels."""
    matrix = np.asarray(camera.matrix)
    upper, turn = rq(matrix[:, :3])
    signs = np.diag(np.sign(np.diag(upper)))
    upper, turn = upper @ signs, signs @ turn
    upper = upper / upper[2, 2]
    focal = float(np.sqrt(upper[0, 0] * upper[1, 1]))
    skew = max(abs(upper[0, 0] - upper[1, 1]), abs(upper[0, 1]))
    if skew > _SQUARE * focal or np.linalg.det(turn) < 0.0:
        return None
    pose = StoredCamera(
        camera.name, camera.rows, camera.columns, np.array(camera.center_mm), turn, where
    )
    middle = (float(upper[0, 2]), float(upper[1, 2]))
    return replace(plain_camera(pose, focal, middle, Distortion(), PIXEL_MM), name=camera.name)


def write_cameras(
    folder: Path, cameras: Sequence[CameraModel], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write pixels of points (n, 3) in all cameras; raises InputError for no points."""
    if points_mm is None:
        raise InputError("lpt-challenge: expected a grid, over which the points are placed")
    columns = [points_mm, *(camera.project(points_mm)[0] for camera in cameras)]
    rows = np.hstack(columns).tolist()
    text = "".join(" ".join(repr(value) for value in row) + "\n" for row in rows)
    (folder / _FILE).write_text(text, encoding="utf-8")


LOST_OF_TRACKS = ("intensities, velocities and accelerations",)
_NAME = r"(?:.*?\D)?(?P<frame>\d+)\.(?:dat|txt|tec)"
_HEAD = re.compile(r"^\s*(title|variables|zone)\b", re.IGNORECASE)
_WORD = re.compile(r'"([^"]*)"|([^\s",=]+)')


def read_tracks(path: Path, unit: str | None, interval_s: float | None) -> TrackTable:
    """Read all files of a folder, or one file as frame 0.

    Raises InputError for a missing file, or a broken one; tracked particles in some frames only.
    """
    files = list(numbered_files(path, _NAME)) if path.is_dir() else [(0, path)]
    if not files:
        raise InputError(f"{path}: expected files NAME_N.dat or .txt, N the frame, found none")
    read = [(file, _read_frame(file, number, unit)) for number, file in files]
    parts = [part for _, part in read if len(part)] or [read[0][1]]
    linked = [part.trajectory is not None for part in parts]
    if any(linked) and not all(linked):
        odd = next(file for file, part in read if len(part) and part.trajectory is None)
        raise InputError(f"{odd}: expected a number for each particle, as in other files, got none")
    if not any(linked):
        note(f"{path}: its particles have no numbers of tracks")
    names = ("frame", "position_mm", *(("trajectory",) if all(linked) else ()))
    return TrackTable(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _read_frame(file: Path, number: int, unit: str | None) -> TrackTable:
    """Read one file; its head may be missing."""
    heads = [(line, text) for line, text in content_lines(file) if _HEAD.match(text)]
    values = read_table(file, 3, skip_lines=heads[-1][0] if heads else 0).values
    variables = next((text for _, text in heads if text.lower().startswith("variables")), "")
    names = [a or b for a, b in _WORD.findall(variables.partition("=")[2])]
    if not names or not len(values):
        factor = 1.0 if unit is None else unit_mm(unit)
        whole = values.shape[1] == 4 and bool((values[:, 3] == np.rint(values[:, 3])).all())
        track = values[:, 3].astype(np.int64) if whole else None
        return TrackTable(np.full(len(values), number), values[:, :3] * factor, track)
    if len(names) != values.shape[1]:
        raise InputError(
            f"{file}: variables: expected as many names as columns, {values.shape[1]}, got "
            f"{len(names)}"
        )
    columns = {name: UnitArray(values[:, i], None) for i, name in enumerate(names)}
    frame = UnitArray(np.full(len(values), float(number)), None)
    return table_of_columns(str(file), columns | {"frame": frame}, unit)


def write_tracks(folder: Path, table: TrackTable, recording: Recording) -> None:
    """Write particles_0000.dat and so on."""
    names = '"X" "Y" "Z"' + ("" if table.trajectory is None else ' "PartID"')
    for frame in range(recording.frames):
        part = table.of_frame(frame)
        rows = [" ".join(map(repr, row)) for row in part.position_mm.tolist()]
        if part.trajectory is not None:
            rows = [f"{row} {n}" for row, n in zip(rows, part.trajectory.tolist(), strict=True)]
        head = f'Title = "Snapshot {frame}"\nVariables = {names}\nZone I={len(part)}, F=POINT\n'
        text = head + "".join(f"{row}\n" for row in rows)
        (folder / f"particles_{frame:04d}.dat").write_text(text, encoding="utf-8")
