"""Limits of the numbers in cameras.json, beyond which nothing can be computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.geometry.wall_records import WallRecord
from sabench.scenes.wall import MOST_LAYERS
from sabench.utils.errors import InputError

_FARTHEST_MM = 1e9  # a thousand kilometres
_LONGEST = 1_000_000  # voxels or pixels along a side


def check_shown(path: Path, shows: Sequence[str]) -> None:
    """Check the kinds of objects that frames show.

    Raises
    ------
    InputError
        None, one twice, or a code without the body that carries it.
    """
    distinct = set(shows)
    if not distinct or len(distinct) != len(shows) or _lone_code(shows):
        expected = "particles, bubbles or both, each once, and code after bubbles only"
        raise InputError(f"{path}: shows: expected {expected}, got {list(shows)}")


def _lone_code(shows: Sequence[str]) -> bool:
    return "code" in shows and tuple(shows[-2:]) != ("bubbles", "code")


def check_lengths(
    path: Path, walls: Sequence[WallRecord | None], cameras: Sequence[CameraModel], grid: Grid
) -> None:
    """Check that lengths and coordinates are such as a laboratory has.

    Raises
    ------
    InputError
        A wall of too many layers, a grid or image of too many voxels or pixels along a side, or a
        length beyond a thousand kilometres.
    """
    for wall in walls:
        if wall is not None and len(wall.layers) > MOST_LAYERS:
            got = len(wall.layers)
            raise InputError(f"{path}: wall: expected at most {MOST_LAYERS} layers, got {got}")
    for name, counts in (("grid", grid.shape), *((c.name, (c.rows, c.columns)) for c in cameras)):
        if max(counts) > _LONGEST:
            expected = f"expected at most {_LONGEST} voxels or pixels along a side"
            raise InputError(f"{path}: {name}: {expected}, got {max(counts)}")
    for name, values in _lengths(walls, cameras, grid):
        largest = max(map(abs, values))
        if largest > _FARTHEST_MM:
            raise InputError(
                f"{path}: {name}: expected at most {_FARTHEST_MM:g} mm, got {largest:g}"
            )


def _lengths(
    walls: Sequence[WallRecord | None], cameras: Sequence[CameraModel], grid: Grid
) -> Iterator[tuple[str, Sequence[float]]]:
    size = [step * count for step, count in zip(grid.voxel_mm, grid.shape[::-1], strict=True)]
    yield "grid", [*grid.low_mm, *size]
    for camera in (one for one in cameras if isinstance(one, Camera)):
        lens = (camera.principal_distance_mm, camera.focal_length_mm, camera.pixel_mm)
        yield camera.name, [*camera.center_mm, *lens]
    for wall in walls:
        if wall is not None:
            yield "wall", _wall_lengths(wall)


def _wall_lengths(wall: WallRecord) -> list[float]:
    thick = [layer.thickness_mm for layer in wall.layers]
    if isinstance(wall, Wall):
        return [*wall.point_mm, *thick, wall.depth_mm or 0.0]
    return [*wall.axis_point_mm, *thick, wall.outer_radius_mm]
