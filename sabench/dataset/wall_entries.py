"""Walls in cameras.json: one of all cameras, or one of each."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.refraction import Wall
from sabench.geometry.wall_records import WallRecord
from sabench.utils.errors import InputError

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

    Raises
    ------
    InputError
        Another number of walls than of cameras, a direction that is not a unit vector, or a size
        or index that is not positive.
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
