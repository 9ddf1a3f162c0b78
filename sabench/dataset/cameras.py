"""Cameras of a data set, in `cameras.json` and `true_cameras.json`."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from sabench.dataset import schema
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.camera_records import CameraEntry, check_largest, record_camera
from sabench.geometry.cylinder_wall import WallRecord, WallsRecord
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.images.preprocessing import Step
from sabench.scenes.wall import MOST_LAYERS
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, inside, read_json
from sabench.utils.validation import LensNumber, WallNumber


def _check_counts(
    path: Path, walls: Sequence[WallRecord | None], cameras: Sequence[CameraModel], grid: Grid
) -> None:
    """Refuse too many layers of a wall, or voxels or pixels along a side."""
    for wall in walls:
        if wall is not None and len(wall.layers) > MOST_LAYERS:
            got = len(wall.layers)
            raise InputError(f"{path}: wall: expected at most {MOST_LAYERS} layers, got {got}")
    for name, counts in (("grid", grid.shape), *((c.name, (c.rows, c.columns)) for c in cameras)):
        if max(counts) > schema.MOST:
            expected = f"expected at most {schema.MOST} voxels or pixels along a side"
            raise InputError(f"{path}: {name}: {expected}, got {max(counts)}")


AnyCamera = TypeVar("AnyCamera", bound=CameraModel)


def wall_entry(cameras: Sequence[CameraModel]) -> Any:
    """Make the key `wall` of cameras.json: one wall, or one for each camera."""
    walls = [camera.wall if isinstance(camera, Camera) else None for camera in cameras]
    if all(wall == walls[0] for wall in walls):
        return walls[0] if walls else None
    return [wall and dataclasses.asdict(wall) for wall in walls]


def behind(
    walls: Sequence[WallRecord | None], cameras: Sequence[AnyCamera]
) -> tuple[AnyCamera, ...]:
    """Put each pinhole behind its own wall; other camera models include refraction."""
    pairs = zip(cameras, walls, strict=True)
    return tuple(
        dataclasses.replace(camera, wall=wall) if isinstance(camera, Camera) else camera
        for camera, wall in pairs
    )


def check_walls(path: Path, walls: Sequence[WallRecord | None], cameras: int) -> None:
    """Check what the types cannot express of the walls of some cameras.

    Raises InputError for another number of walls than of cameras, a direction that is not a unit
    vector, or a size or index that is not positive.
    """
    if len(walls) != cameras:
        raise InputError(
            f"{path}: wall: expected one, or one for each of {cameras} cameras, got {len(walls)}"
        )
    for one in walls:
        if one is not None and not _is_sound(one):
            expected = (
                "a unit normal and positive indices and thicknesses"
                if isinstance(one, Wall)
                else "a unit axis and positive radii, indices and thicknesses"
            )
            raise InputError(f"{path}: wall: expected {expected}, got {one}")


def _is_sound(wall: WallRecord) -> bool:
    sizes = [*wall.indices, *(layer.thickness_mm for layer in wall.layers)]
    direction = wall.normal if isinstance(wall, Wall) else wall.axis
    if not isinstance(wall, Wall):
        sizes += [*wall.radii_mm]
    return abs(float(np.linalg.norm(direction)) - 1.0) <= 1e-9 and min(sizes) > 0.0


MOST_DN = np.iinfo(np.uint16).max


class SensorLevels(schema.StoredRecord):
    """Grey levels of the sensor: of no light and of saturation.

    `by_camera` has both of each camera where they differ, as dark images show them.
    """

    black_dn: float
    white_dn: float
    bit_depth: int = Field(ge=1, le=16)
    by_camera: tuple[tuple[float, float], ...] = ()


class CamerasFile(schema.VersionedFile):
    """cameras.json: the observation, apart from the images."""

    frames: int = Field(ge=1, le=schema.MOST)  # tasks list them
    interval_s: float = Field(gt=0)
    wall: WallsRecord | None
    cameras: tuple[CameraEntry, ...] = Field(min_length=1)
    grid: Grid
    sensor: SensorLevels
    unknown: tuple[LensNumber | WallNumber, ...] = ()
    known_cameras: bool = False
    times_s: tuple[float, ...] | None = None
    pulses: int = Field(1, ge=1)
    preprocessing: tuple[Step, ...] = ()
    shows: tuple[Literal["particles", "bubbles", "code"], ...] = ("particles",)

    @property
    def pinholes(self) -> tuple[Camera, ...]:
        """The cameras, if all are pinholes; raises InputError for another model."""
        other = next((one.name for one in self.cameras if not isinstance(one, Camera)), None)
        if other is not None:
            raise InputError(f"{other}: expected a pinhole camera, got another camera model")
        return tuple(one for one in self.cameras if isinstance(one, Camera))

    def walls_of_cameras(self) -> tuple[WallRecord | None, ...]:
        """List the wall that each camera looks through."""
        return _walls(self.wall, len(self.cameras))

    def time_s(self, frame: int) -> float:
        """Compute the time of a frame."""
        return frame * self.interval_s if self.times_s is None else self.times_s[frame]

    def sequences(self) -> list[range]:
        """List the sequences of frames.

        They are the groups of pulses; without groups there is one sequence of all frames.
        """
        step = self.pulses if self.pulses > 1 else self.frames
        return [
            range(first, min(first + step, self.frames)) for first in range(0, self.frames, step)
        ]

    def pairs(self) -> list[tuple[int, int]]:
        """List the pairs of frames that follow each other within a sequence."""
        return [pair for frames in self.sequences() for pair in itertools.pairwise(frames)]


class TrueCamerasFile(schema.VersionedFile):
    """true_cameras.json: the true cameras, where cameras.json holds others.

    `wall` is there where the true wall is not the nominal one.
    """

    wall: WallsRecord | None = None
    cameras: tuple[Camera, ...]


class CalibratedFile(schema.VersionedFile):
    """cameras.json of a calibration: cameras and their walls alone."""

    wall: WallsRecord | None = None
    cameras: tuple[CameraEntry, ...] = Field(min_length=1)


def read_calibrated(path: Path) -> tuple[tuple[CameraModel, ...], Grid | None]:
    """Read the cameras of a calibration, or those of a data set and its grid.

    Cameras of a calibration may differ in image size.

    Raises InputError for another kind of file, or broken cameras.
    """
    keys = read_json(path)
    if isinstance(keys, dict) and "grid" in keys:
        setup = read_cameras(path.parent)
        return setup.cameras, setup.grid
    check_largest(keys, str(path))
    loaded = schema.read_versioned(CalibratedFile, path)
    walls = _walls(loaded.wall, len(loaded.cameras))
    _check_names(loaded.cameras, path)
    _check_cameras(loaded.cameras, path)
    check_walls(path, walls, len(loaded.cameras))
    return behind(walls, loaded.cameras), None


def read_cameras(root: Path) -> CamerasFile:
    """Read the cameras of a data set, every one with its wall."""
    path = inside(root, schema.CAMERAS)
    return check_setup(read_json(path), path)


def check_setup(value: Any, path: Path) -> CamerasFile:
    """Check the cameras of a data set, as `cameras.json` and shards hold them."""
    loaded = schema.check_versioned(CamerasFile, value, path)
    _check_levels(loaded, path)
    check_largest(value, str(path))
    _check_names(loaded.cameras, path)
    _check_cameras(loaded.cameras, path)
    first = loaded.cameras[0]
    for camera in loaded.cameras:
        if (camera.rows, camera.columns) != (first.rows, first.columns):
            got = f"{camera.rows} x {camera.columns}"
            raise InputError(
                f"{path}: {camera.name}: expected {first.rows} x {first.columns} pixels (rows x "
                f"columns) as {first.name} has, got {got}"
            )
    distinct = set(loaded.shows)
    if (
        not distinct
        or len(distinct) != len(loaded.shows)
        or ("code" in loaded.shows and tuple(loaded.shows[-2:]) != ("bubbles", "code"))
    ):
        expected = "particles, bubbles or both, each once, and code after bubbles only"
        raise InputError(f"{path}: shows: expected {expected}, got {list(loaded.shows)}")
    check_walls(path, loaded.walls_of_cameras(), len(loaded.cameras))
    _check_counts(path, loaded.walls_of_cameras(), loaded.cameras, loaded.grid)
    _check_grid(loaded.grid, path)
    return loaded.model_copy(update={"cameras": behind(loaded.walls_of_cameras(), loaded.cameras)})


def read_true_cameras(root: Path, nominal: CamerasFile) -> tuple[Camera, ...]:
    """Read the true cameras of a data set with nominal ones in cameras.json.

    They have the same names and image sizes, and are behind the same walls unless the file has
    others.
    """
    path = inside(root, schema.TRUE_CAMERAS)
    return check_true_cameras(read_json(path), path, nominal)


def check_true_cameras(value: Any, path: Path, nominal: CamerasFile) -> tuple[Camera, ...]:
    """Check true cameras, as `true_cameras.json` and shards hold them."""
    loaded = schema.check_versioned(TrueCamerasFile, value, path)
    check_largest(value, str(path))
    cameras = loaded.cameras
    expected, got = (
        [(c.name, c.rows, c.columns) for c in group] for group in (nominal.cameras, cameras)
    )
    if got != expected:
        raise InputError(
            f"{path}: cameras: expected names and image sizes as in {schema.CAMERAS}, {expected}, "
            f"got {got}"
        )
    _check_cameras(cameras, path)
    walls = _walls(loaded.wall, len(cameras)) if loaded.wall else nominal.walls_of_cameras()
    check_walls(path, walls, len(cameras))
    _check_counts(path, walls, cameras, nominal.grid)
    return behind(walls, cameras)


def _walls(wall: WallsRecord | None, cameras: int) -> tuple[WallRecord | None, ...]:
    return wall if isinstance(wall, tuple) else (wall,) * cameras


def _check_names(cameras: Sequence[CameraModel], path: Path) -> None:
    names = [camera.name for camera in cameras]
    if len(set(names)) != len(names) or not all(name.replace("_", "").isalnum() for name in names):
        raise InputError(
            f"{path}: cameras: expected different names of letters, digits and _, got {names}"
        )


def _check_cameras(cameras: Sequence[CameraModel], path: Path) -> None:
    for camera in cameras:
        sizes: tuple[float, ...] = (camera.rows, camera.columns)
        if isinstance(camera, Camera):
            lens = (camera.focal_length_mm, camera.f_number)
            sizes = (*sizes, camera.pixel_mm, camera.principal_distance_mm, *lens)
        if min(sizes) <= 0:
            raise InputError(f"{path}: {camera.name}: expected positive sizes, got {sizes}")
        if isinstance(camera, Camera):
            _check_rotation(camera, path)
        else:
            _check_map(camera, path)


def _check_rotation(camera: Camera, path: Path) -> None:
    rotation = np.asarray(camera.rotation)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0.0:
        raise InputError(
            f"{path}: {camera.name}: rotation: expected a right-handed orthonormal matrix, got "
            f"{rotation.tolist()}"
        )


def _check_map(camera: CameraModel, path: Path) -> None:
    """Check that a camera without optics maps points, and has lines of sight."""
    middle = np.array([[(camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0]])
    try:
        with np.errstate(all="ignore"):
            rays = camera.back_project(middle)
            _, there = camera.project(rays.origins_mm + rays.directions)
            sound = bool(rays.valid[0] and np.isfinite([*camera.center_mm]).all() and len(there))
    except (ArithmeticError, IndexError, ValueError) as error:  # sizes of matrices, singular ones
        raise InputError(
            f"{path}: {camera.name}: expected a camera that maps points to pixels, got {error}"
        ) from error
    if not sound:
        raise InputError(
            f"{path}: {camera.name}: expected a line of sight of its middle pixel, got none"
        )


def _check_levels(loaded: CamerasFile, path: Path) -> None:
    levels = loaded.sensor
    if not levels.black_dn < levels.white_dn:
        raise InputError(
            f"{path}: sensor: expected black_dn below white_dn, got {levels.black_dn:g} and "
            f"{levels.white_dn:g}"
        )
    if levels.by_camera and len(levels.by_camera) != len(loaded.cameras):
        raise InputError(
            f"{path}: sensor.by_camera: expected two levels for each of {len(loaded.cameras)} "
            f"cameras, got {len(levels.by_camera)}"
        )
    for camera, (black, white) in zip(loaded.cameras, levels.by_camera, strict=False):
        if not 0.0 <= black < white <= MOST_DN or not 0.0 <= levels.black_dn <= MOST_DN:
            raise InputError(
                f"{path}: sensor.by_camera: {camera.name}: expected black below white, of 0 to "
                f"{MOST_DN}, got {black:g} and {white:g}, and black_dn = {levels.black_dn:g}"
            )


def _check_grid(grid: Grid, path: Path) -> None:
    if min(*grid.shape, *grid.voxel_mm) <= 0 or any(
        cut < 0 or 2 * cut >= n for cut, n in zip(grid.crop, grid.shape[::-1], strict=True)
    ):
        raise InputError(
            f"{path}: grid: expected positive shape and voxels and a crop that leaves some, got "
            f"{grid}"
        )


def write_cameras(path: Path, cameras: Sequence[CameraModel], **keys: Any) -> None:
    """Write cameras as `list_cameras` lists them."""
    path.write_text(canonical_json(list_cameras(cameras, **keys)), encoding="utf-8")


def list_cameras(cameras: Sequence[CameraModel], **keys: Any) -> dict[str, Any]:
    """Make the content of `cameras.json`.

    Parameters
    ----------
    keys : further keys of the file, such as `wall`, see `wall_entries.wall_entry`.
    """
    records = [_camera_entry(camera) for camera in cameras]
    values = {key: _plain(value) for key, value in keys.items()}
    head = {"format": schema.FORMAT, "version": schema.VERSION}
    return {**head, **values, "cameras": records}


def _camera_entry(camera: CameraModel) -> dict[str, Any]:
    """Make a camera's entry.

    The entry of a pinhole leaves out the wall and the model, which is the default.
    """
    record = record_camera(camera)
    if isinstance(camera, Camera):
        del record["model"], record["wall"]
    return record


def _plain(value: Any) -> Any:
    """Convert a dataclass to what JSON holds; leave anything else as it is."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    return value
