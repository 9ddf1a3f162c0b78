"""Names, keys and their checks that writing, reading and verifying share."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sabench.errors import InputError
from sabench.files import canonical_json, inside, read_json
from sabench.optics.camera import Camera
from sabench.optics.wall import Wall
from sabench.scene import Model, validate
from sabench.volume import Grid

FORMAT = "sabench-dataset"
VERSION = 1
MANIFEST, CAMERAS, SCENE, TRUTH = "manifest.json", "cameras.json", "scene.toml", "truth.h5"


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorLevels(_Record):
    """What an experimenter knows of the sensor."""

    black_dn: float
    white_dn: float
    bit_depth: int = Field(ge=1, le=16)


class CamerasFile(_Record):
    """cameras.json: the whole observation side but for the images."""

    format: str
    version: int
    frames: int = Field(ge=1)
    interval_s: float = Field(gt=0)
    wall: Wall | None
    cameras: tuple[Camera, ...] = Field(min_length=1)
    grid: Grid
    sensor: SensorLevels


class FileEntry(_Record):
    """One file's size and checksum."""

    bytes: int = Field(ge=0)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class Manifest(_Record):
    """manifest.json: what the data set consists of and came from."""

    format: str
    version: int
    content_hash: str = Field(pattern="^[0-9a-f]{64}$")
    scene: str
    scene_hash: str = Field(pattern="^[0-9a-f]{64}$")
    seed: int = Field(ge=0)
    renderer: str
    versions: dict[str, str]
    files: dict[str, FileEntry]
    manifest_hash: str = Field(pattern="^[0-9a-f]{64}$")


def image_name(camera: str, frame: int, suffix: str) -> str:
    """Path of an image inside a data set; `suffix` is tif (grey values) or exr (radiance)."""
    return f"images/frame_{frame:04d}/{camera}.{suffix}"


def frame_group(frame: int) -> str:
    """HDF5 group of a frame, in truth and result files."""
    return f"frames/{frame:04d}"


def content_hash(files: dict[str, FileEntry]) -> str:
    """Names a data set: SHA-256 over the canonical JSON of path -> SHA-256."""
    return hashlib.sha256(canonical_json({name: entry.sha256 for name, entry in files.items()}).encode()).hexdigest()


def sealed(manifest: dict[str, Any]) -> str:
    """The manifest's text, with the hash of all its other keys as `manifest_hash`."""
    rest = {key: value for key, value in manifest.items() if key != "manifest_hash"}
    return canonical_json({**rest, "manifest_hash": hashlib.sha256(canonical_json(rest).encode()).hexdigest()})


def read_manifest(root: Path) -> Manifest:
    """The manifest of a data set; InputError if there is none, it is broken or of another format."""
    path = inside(root, MANIFEST)
    if not root.is_dir() or not path.is_file():
        raise InputError(f"{path}: expected a data set's manifest, found none")
    manifest = _checked(Manifest, path)
    if path.read_text(encoding="utf-8") != sealed(manifest.model_dump(mode="json")):
        raise InputError(f"{path}: its manifest_hash does not match its content")
    return manifest


def read_cameras(root: Path) -> CamerasFile:
    """The rig of a data set, every camera with its wall."""
    path = inside(root, CAMERAS)
    loaded = _checked(CamerasFile, path)
    names = [camera.name for camera in loaded.cameras]
    if len(set(names)) != len(names) or not all(name.replace("_", "").isalnum() for name in names):
        raise InputError(f"{path}: cameras: expected different names of letters, digits and _, got {names}")
    _check_numbers(loaded, path)
    return loaded.model_copy(update={"cameras": tuple(dataclasses.replace(c, wall=loaded.wall) for c in loaded.cameras)})


def _check_numbers(loaded: CamerasFile, path: Path) -> None:
    """What the types cannot say."""
    for camera in loaded.cameras:
        sizes = (camera.rows, camera.columns, camera.pixel_mm, camera.principal_distance_mm, camera.focal_length_mm, camera.f_number)
        if min(sizes) <= 0:
            raise InputError(f"{path}: {camera.name}: expected positive sizes, got {sizes}")
        turn = np.asarray(camera.rotation)
        if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-9 or np.linalg.det(turn) < 0.0:
            raise InputError(f"{path}: {camera.name}: rotation: expected a right-handed orthonormal matrix, got {turn.tolist()}")
    wall, grid = loaded.wall, loaded.grid
    if wall and (abs(np.linalg.norm(wall.normal) - 1.0) > 1e-9 or min(*wall.indices, *(layer.thickness_mm for layer in wall.layers)) <= 0.0):
        raise InputError(f"{path}: wall: expected a unit normal and positive indices and thicknesses, got {wall}")
    if min(*grid.shape, *grid.voxel_mm) <= 0 or any(cut < 0 or 2 * cut >= n for cut, n in zip(grid.crop, grid.shape[::-1], strict=True)):
        raise InputError(f"{path}: grid: expected positive shape and voxels and a crop that leaves some, got {grid}")


def _checked(model: type[Model], path: Path) -> Model:
    value = read_json(path)
    if not isinstance(value, dict) or value.get("format") != FORMAT or value.get("version") != VERSION:
        got = f"{value.get('format')!r} version {value.get('version')!r}" if isinstance(value, dict) else type(value).__name__
        raise InputError(f"{path}: expected format {FORMAT!r} version {VERSION}, got {got}")
    return validate(model, value, str(path))


def rig_to_dict(cameras: tuple[Camera, ...], wall: Wall | None) -> dict[str, Any]:
    """Cameras and their common wall as JSON keeps them."""
    records = [{k: v for k, v in dataclasses.asdict(camera).items() if k != "wall"} for camera in cameras]
    return {"wall": dataclasses.asdict(wall) if wall else None, "cameras": records}
