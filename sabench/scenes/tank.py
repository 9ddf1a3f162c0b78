"""Walls of a scene's tank, and which of them a camera looks through."""

from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.refraction import Layer, Wall, trace_to_points
from sabench.scenes.scene import Scene
from sabench.scenes.wall import CylinderSpec, WallSpec, WallTable, wall_tables
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError

TankWall = Wall | CylinderWall


@overload
def build_wall(spec: WallSpec) -> Wall: ...
@overload
def build_wall(spec: CylinderSpec) -> CylinderWall: ...
def build_wall(spec: WallSpec | CylinderSpec) -> TankWall:
    """Build a wall of a tank; its normal or axis becomes a unit vector."""
    layers = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in spec.layers)
    media = (spec.air_index, layers, spec.fluid_index)
    if isinstance(spec, CylinderSpec):
        axis = triple(np.asarray(spec.axis) / np.linalg.norm(spec.axis))
        return CylinderWall(spec.axis_point_mm, axis, spec.outer_radius_mm, *media)
    unit = triple(np.asarray(spec.normal) / np.linalg.norm(spec.normal))
    return Wall(spec.point_mm, unit, *media, spec.depth_mm)


def build_walls(wall: WallTable | None) -> tuple[TankWall, ...]:
    """Build all walls of a tank; none in plain air.

    Raises
    ------
    InputError
        Walls with different fluids behind them, or a mirroring wall among several.
    """
    specs = wall_tables(wall)
    for number, spec in enumerate(specs):
        if isinstance(spec, WallSpec) and spec.mirrors and len(specs) > 1:
            raise InputError(
                f"wall.{number}.mirrors: expected none, since reflections need a single wall"
            )
        if spec.fluid_index != specs[0].fluid_index:
            raise InputError(
                f"wall.{number}.fluid_index: expected {specs[0].fluid_index:g} as behind the first "
                f"wall, got {spec.fluid_index:g}"
            )
    return tuple(build_wall(spec) for spec in specs)


def check_one_plane(scene: Scene) -> None:
    """Check that a scene has one plane wall or none, as bubbles and bodies need."""
    if scene.walls and scene.plane is None:
        got = "a cylinder" if isinstance(scene.wall, CylinderSpec) else f"{len(scene.walls)} walls"
        raise InputError(f"wall: expected one plane wall for bubbles and bodies, got {got}")


def is_outside(walls: Sequence[TankWall], center_mm: F64) -> bool:
    """Return whether a camera is in front of a wall, or in plain air."""
    return not walls or min(float(wall.depth_of(center_mm)) for wall in walls) < 0.0


def wall_towards(walls: Sequence[TankWall], center_mm: F64, target_mm: F64) -> TankWall | None:
    """Choose the wall between a camera and a point; None in plain air.

    It is the last wall that the straight line from the camera to the point enters.
    """
    if not walls:
        return None
    before = [float(wall.depth_of(center_mm)) for wall in walls]
    entered = [
        -depth / max(float(wall.depth_of(target_mm)) - depth, 1e-300) if depth < 0.0 else -1.0
        for wall, depth in zip(walls, before, strict=True)
    ]
    return walls[int(np.argmax(entered))]


def check_one_face(camera: Camera, walls: Sequence[TankWall], corners: F64) -> None:
    """Check that a camera sees a volume's corners (8, 3) through its own wall alone.

    Raises
    ------
    InputError
        A light path that crosses the edge between two walls, or an image of a corner on the sensor
        through another wall.
    """
    facing = next(i for i, wall in enumerate(walls) if wall is camera.wall)
    for number, other in enumerate(walls):
        if number == facing:
            continue
        beyond = (_beyond(camera, walls[facing], other, corners) > 0.0).any()
        pixels, valid = replace(camera, wall=other).project(corners)
        visible = valid & camera.contains(pixels)
        for third in walls:
            if third is not other:
                visible &= ~(_beyond(camera, other, third, corners) > 0.0)
        if beyond or visible.any():
            raise InputError(
                f"cameras: {camera.name} at {list(camera.center_mm)} mm: expected it to see the "
                f"volume through one wall, but it faces two, wall.{facing} and wall.{number}"
            )


def _beyond(camera: Camera, wall: TankWall, other: TankWall, corners: F64) -> F64:
    """Compute how far outside the tank light paths cross a plane wall, mm.

    Outside is in front of the other wall; (8,), NaN without a path.
    """
    pinhole = np.asarray(camera.center_mm)
    leaving = trace_to_points(wall, pinhole, corners).leaving
    ends = wall.rays(pinhole, leaving).origins_mm
    length = -wall.depth_of(pinhole) / (leaving @ wall.normal_at(pinhole))
    starts = pinhole + length[:, None] * leaving
    return np.asarray(np.fmax(-other.depth_of(starts), other.thickness_mm - other.depth_of(ends)))
