"""Cameras in MATLAB's files: structures of camera parameters.

MATLAB's objects `cameraParameters` and `cameraIntrinsics` cannot be read outside MATLAB; their
structures, as `toStruct` makes them, can. A structure of one camera has the lens (`K`, or the
transposed `IntrinsicMatrix`; `RadialDistortion`, `TangentialDistortion`, `ImageSize`) and its place
`R` and `t` with x = R X + t, or the older `RotationMatrix` and `TranslationVector` of row vectors.
Pixel (1, 1) is the centre of the first pixel.
"""

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from sabench.dataset.hdf5 import open_hdf5, read_array
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.lens import Distortion
from sabench.interop.lenses import Extent, StoredCamera, camera_of_matrix, center_of
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from sabench.worlds.library.array_files import load_old_matlab

_LENS = ("K", "IntrinsicMatrix", "RadialDistortion", "TangentialDistortion", "ImageSize")
_FIELDS = (*_LENS, "R", "t", "T", "RotationMatrix", "TranslationVector")
Structure = dict[str, F64]


def read_cameras(path: Path, extent: Extent) -> list[CameraModel]:
    """Read all structures of cameras in a .mat file, in the order of their names.

    Raises InputError for a missing file, no structure of a camera in it, or one without a lens or a
    place.
    """
    if not path.is_file():
        raise InputError(f"{path}: expected a .mat file, found none")
    structures = (_structures_of_hdf5 if h5py.is_hdf5(path) else _structures_of_mat)(path)
    lenses = {"K", "IntrinsicMatrix"}
    cameras = {name: fields for name, fields in structures.items() if lenses & fields.keys()}
    if not cameras:
        raise InputError(
            f"{path}: expected structures with K or IntrinsicMatrix, R and t (made with toStruct), "
            f"found {', '.join(structures) or 'none'}"
        )
    return [_camera(path, name, fields, extent) for name, fields in sorted(cameras.items())]


def _structures_of_hdf5(path: Path) -> dict[str, Structure]:
    """Read the structures of version 7.3, which stores arrays transposed."""
    structures = {}
    with open_hdf5(path) as file:
        for name in list(file):
            node = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
            if isinstance(node, h5py.Group):
                fields = [field for field in _FIELDS if field in node]
                structures[name] = {
                    field: read_array(file, f"{name}/{field}", (None, None), "fiu").T.astype(float)
                    for field in fields
                }
    return structures


def _structures_of_mat(path: Path) -> dict[str, Structure]:
    """Read the structures of versions 4 to 7."""
    structures = {}
    for name, value in load_old_matlab(path).items():
        fields = getattr(value, "dtype", np.dtype(float)).names
        if fields and value.size == 1:
            wanted = {field: value[field].flat[0] for field in fields if field in _FIELDS}
            structures[name] = {
                field: np.asarray(array, dtype=np.float64)
                for field, array in wanted.items()
                if getattr(array, "dtype", np.dtype(object)).kind in "fiu"
            }
    return structures


def _camera(path: Path, name: str, fields: Structure, extent: Extent) -> CameraModel:
    where = f"{path}: {name}"
    matrix = _shaped(where, fields, "K", 9).reshape(3, 3) if "K" in fields else None
    if matrix is None:
        matrix = _shaped(where, fields, "IntrinsicMatrix", 9).reshape(3, 3).T
    matrix = matrix.copy()
    matrix[:2, 2] -= 1.0
    rotation, move = _place(where, fields)
    radial = [*fields.get("RadialDistortion", np.zeros(2)).ravel(), 0.0, 0.0, 0.0][:3]
    p2, p1 = [*fields.get("TangentialDistortion", np.zeros(2)).ravel(), 0.0, 0.0][1::-1]
    lens = Distortion(float(radial[0]), float(radial[1]), float(p1), float(p2), float(radial[2]))
    size = fields.get("ImageSize")
    rows, columns = extent.image(where) if size is None else size.ravel()[:2].astype(int).tolist()
    pose = StoredCamera(name, rows, columns, center_of(rotation, move), rotation, where)
    return camera_of_matrix(pose, matrix, lens)


def _place(where: str, fields: Structure) -> tuple[F64, F64]:
    if "RotationMatrix" in fields:
        turn = _shaped(where, fields, "RotationMatrix", 9).reshape(3, 3).T
        return turn, _shaped(where, fields, "TranslationVector", 3)
    turn = _shaped(where, fields, "R", 9).reshape(3, 3)
    return turn, _shaped(where, fields, "t" if "t" in fields else "T", 3)


def _shaped(where: str, fields: Structure, name: str, size: int) -> F64:
    value = fields.get(name)
    if value is None or value.size != size or not np.isfinite(value).all():
        got = "none" if value is None else f"an array of shape {value.shape}"
        raise InputError(f"{where}: {name}: expected {size} finite numbers, got {got}")
    return value.ravel() if size == 3 else value


def unfit(cameras: Sequence[CameraModel]) -> str | None:
    """Return why cameras cannot be written: MATLAB's objects are proprietary."""
    return "expected a format that cameras can be written in, as opencv"
