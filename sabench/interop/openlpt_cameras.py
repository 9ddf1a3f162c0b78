"""Camera files of OpenLPT: PINHOLE, and PINPLATE behind parallel plates.

Source: the format as the package openlpt 2.2.4 reads it. Its world is ours, in mm or in another
unit, and pixel (0, 0) is the centre of the first pixel.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.lens import Distortion
from sabench.geometry.refraction import Layer, Wall
from sabench.interop import lenses, openlpt
from sabench.interop.foreign import ForeignWorld
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError
from sabench.utils.tables import content_lines, split_numbers

LOST_OF_CAMERAS = ("f-numbers and focal lengths", "the pixel pitch", "the depth of the tank")
_COUNTS = (2, 3, 3, 3, None, 3, 3, 3, 3, 3, 3, 3, 3, 3)  # numbers on the lines of a pinhole


def read_cameras(path: Path, extent: lenses.Extent) -> list[CameraModel]:
    """Read one camera file, or all of a folder (cam*.txt).

    Raises InputError for a missing camera file, or a broken one.
    """
    files = [path]
    if path.is_dir():  # cam10 behind cam9
        files = sorted(path.glob("cam*.txt"), key=lambda file: (len(file.name), file.name))
    files = [file for file in files if not file.stem.endswith("ImageNames")]
    if not files:
        raise InputError(
            f"{path}: expected OpenLPT's camera files cam0.txt, cam1.txt ..., found none"
        )
    return [_read_camera(file) for file in files]


def _read_camera(path: Path) -> CameraModel:
    lines = [line for line in content_lines(path) if not line[1].startswith("#")]
    kind = lines[0][1].upper() if lines else "nothing"
    if kind not in ("PINHOLE", "PINPLATE"):
        raise InputError(f"{path}: expected a camera model PINHOLE or PINPLATE, got {kind[:40]!r}")
    rest = lines[3:]  # behind the model and two calibration errors
    if len(rest) < len(_COUNTS):
        raise InputError(
            f"{path}: expected {len(_COUNTS)} lines behind the calibration errors, got {len(rest)}"
        )
    rows = [
        np.array(split_numbers(text, f"{path}: line {number}", count))
        for (number, text), count in zip(rest, _COUNTS, strict=False)
    ]
    size, matrix, rotation = rows[0], np.stack(rows[1:4]), np.stack(rows[6:9])
    lenses.check_positive(str(path), "image size", *size)
    wall = _read_plates(path, rest[len(_COUNTS) :]) if kind == "PINPLATE" else None
    center, (height, width) = lenses.center_of(rotation, rows[12]), size.astype(int).tolist()
    pose = lenses.StoredCamera(path.stem, height, width, center, rotation, str(path), wall)
    values = rows[4].tolist()
    if len(values) > 5 and any(values[5:]):
        raise InputError(f"{path}: expected five coefficients of distortion, got {len(values)}")
    return lenses.camera_of_matrix(pose, matrix, Distortion(*(values + 5 * [0.0])[:5]))


def _read_plates(path: Path, lines: Sequence[tuple[int, str]]) -> Wall | None:
    """Read the plates, which are listed from the fluid to the camera."""
    if len(lines) < 4:
        raise InputError(f"{path}: expected a point, a normal, indices and widths of plates")
    point, normal, indices, widths = (
        np.array(split_numbers(text, f"{path}: line {number}")) for number, text in lines[:4]
    )
    if (len(point), len(normal)) != (3, 3) or len(indices) != len(widths) + 2:
        raise InputError(
            f"{path}: plates: expected a point and a normal of 3 numbers and 2 more indices than "
            f"widths, got {len(point)}, {len(normal)}, {len(indices)} and {len(widths)}"
        )
    lenses.check_positive(str(path), "refractive index", *indices)
    lenses.check_positive(str(path), "width", *widths)
    if len(set(indices)) == 1:
        return None
    lenses.check_media(str(path), indices[::-1].tolist())
    normal = normal / np.linalg.norm(normal)
    layers = tuple(
        Layer(f"plate_{number}", float(index), float(width))
        for number, (index, width) in enumerate(zip(indices[-2:0:-1], widths[::-1], strict=True))
    )
    outer = point - normal * widths.sum()
    return Wall(triple(outer), triple(normal), float(indices[-1]), layers, float(indices[0]))


def unfit(cameras: Sequence[CameraModel]) -> str | None:
    """Return why OpenLPT cannot describe cameras; None if it can."""
    for camera in cameras:
        if not isinstance(camera, Camera):
            return f"{camera.name}: OpenLPT has pinholes with Brown-Conrady's distortion only"
        if reason := openlpt.unfit(camera):
            return f"{camera.name}: {reason}"
    return None


def write_cameras(
    folder: Path, cameras: Sequence[Camera], world: ForeignWorld, points_mm: F64 | None
) -> None:
    """Write cam0.txt, cam1.txt and so on."""
    for number, camera in enumerate(cameras):
        text = openlpt.camera_text(camera)
        (folder / f"cam{number}.txt").write_text(text, encoding="utf-8")
