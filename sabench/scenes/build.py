"""Build a scene's rig: the wall, the aimed and focused cameras, the voxel grid, occluders."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from sabench.geometry import array_layouts
from sabench.geometry.camera import Camera, Distortion, aim, aimed_rotation
from sabench.geometry.frames import Domain
from sabench.geometry.grid import Grid
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Layer, Wall
from sabench.scenes import checks
from sabench.scenes.cameras import (
    Cameras,
    CrossLayout,
    GridLayout,
    LineLayout,
    ListLayout,
    Place,
    RingLayout,
)
from sabench.scenes.scene import Scene
from sabench.scenes.wall import OccluderSpec, WallSpec
from sabench.utils.arrays import F64, triple
from sabench.utils.errors import InputError

_MOST_CAMERAS = 1000


@dataclass(frozen=True)
class Rig:
    """The built optics of a scene: the true cameras (each knows its wall), the grid, and what stands in the way of light."""

    cameras: tuple[Camera, ...]
    wall: Wall | None
    grid: Grid
    occluders: tuple[Disc, ...]


def build_rig(scene: Scene, source: str = "scene") -> Rig:
    """Build and check the rig; `source` is named in errors.

    Raises
    ------
    InputError
        A camera in the wall or the tank, a volume that is not wholly in the fluid, a grid that does
        not fit, no camera that sees the volume, or an occluder that is not between the cameras and
        the wall (or the volume).
    """
    count = _camera_count(scene.cameras)
    if count > _MOST_CAMERAS:
        raise InputError(
            f"{source}: cameras.layout: expected at most {_MOST_CAMERAS} cameras, got {count}"
        )
    wall = build_wall(scene.wall) if scene.wall else None
    corners = _corners(scene)
    if wall:
        checks.check_tank(wall, corners, source)
    cameras = tuple(
        _build_camera(scene, wall, i, place, source)
        for i, place in enumerate(_places(scene.cameras))
    )
    checks.check_views(cameras, corners, source)
    occluders = tuple(_build_occluder(spec) for spec in scene.occluders or ())
    for number, disc in enumerate(occluders):
        checks.check_occluder(disc, wall, cameras, corners, f"{source}: occluders.{number}")
    if scene.backlight:
        checks.check_backlight(scene, wall, cameras, corners, f"{source}: backlight.center_mm")
    return Rig(cameras, wall, build_grid(scene, source), occluders)


def build_grid(scene: Scene, source: str = "scene") -> Grid:
    """Voxels that fill the volume; their number along each axis is rounded."""
    size, voxel, crop = (
        np.asarray(v) for v in (scene.volume.size_mm, scene.grid.voxel_mm, scene.grid.crop_mm)
    )
    counts = np.maximum(1, np.rint(size / voxel).astype(int))
    cut = np.rint(crop / voxel).astype(int)
    if np.any(2 * cut >= counts):
        raise InputError(
            f"{source}: grid.crop_mm: expected less than half of volume.size_mm, got {list(scene.grid.crop_mm)}"
        )
    low = np.asarray(scene.volume.center_mm) - (counts - 1) / 2.0 * voxel
    x, y, z = (int(n) for n in counts)
    return Grid(
        triple(low), scene.grid.voxel_mm, (z, y, x), (int(cut[0]), int(cut[1]), int(cut[2]))
    )


def domain_of(scene: Scene) -> Domain:
    """What the scene's generators fill."""
    return Domain(
        scene.volume.center_mm, scene.volume.size_mm, scene.cameras.rows * scene.cameras.columns
    )


def build_wall(spec: WallSpec) -> Wall:
    unit = _unit(spec.normal)
    layers = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in spec.layers)
    return Wall(
        spec.point_mm, triple(unit), spec.air_index, layers, spec.fluid_index, spec.depth_mm
    )


def _unit(vector: tuple[float, float, float]) -> F64:
    return np.asarray(np.asarray(vector) / np.linalg.norm(vector))


def _build_occluder(spec: OccluderSpec) -> Disc:
    return Disc(spec.center_mm, triple(_unit(spec.normal)), spec.radius_mm)


def _corners(scene: Scene) -> F64:
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return np.asarray(scene.volume.center_mm + signs * np.asarray(scene.volume.size_mm))


def _camera_count(spec: Cameras) -> int:
    """How many cameras a layout has, before any is made."""
    chosen = spec.layout
    if isinstance(chosen, ListLayout):
        return len(chosen.places)
    if isinstance(chosen, CrossLayout):
        return 4 * chosen.arm + 1
    if isinstance(chosen, GridLayout):
        across, down = (
            len(values) if values is not None else count or 1
            for values, count in ((chosen.x_mm, chosen.columns), (chosen.y_mm, chosen.rows))
        )
        return across * down
    return chosen.count


def _places(spec: Cameras) -> list[Place]:
    if isinstance(spec.layout, ListLayout):
        return list(spec.layout.places)
    axes = [_unit(spec.x_axis), _unit(spec.y_axis)]
    centers = np.asarray(spec.center_mm) + _offsets(spec.layout) @ np.stack(axes)
    return [Place(center_mm=triple(c)) for c in centers]


def _offsets(spec: GridLayout | RingLayout | LineLayout | CrossLayout) -> F64:
    if isinstance(spec, RingLayout):
        return array_layouts.ring(spec.count, spec.radius_mm, np.deg2rad(spec.start_deg))
    if isinstance(spec, LineLayout):
        return array_layouts.line(spec.count, spec.spacing_mm, np.deg2rad(spec.angle_deg))
    if isinstance(spec, CrossLayout):
        return array_layouts.cross(spec.arm, spec.spacing_mm)
    if spec.x_mm is not None and spec.y_mm is not None:
        return array_layouts.grid(spec.x_mm, spec.y_mm)
    columns, rows, spacing = (
        spec.columns or 1,
        spec.rows or 1,
        spec.spacing_mm or (1.0, 1.0),
    )  # all given: the scene checks it
    return array_layouts.grid(
        array_layouts.even(columns, spacing[0]), array_layouts.even(rows, spacing[1])
    )


def _build_camera(
    scene: Scene, wall: Wall | None, number: int, place: Place, source: str
) -> Camera:
    spec, name = scene.cameras, f"camera_{number:02d}"
    if wall and wall.depth_of(np.asarray(place.center_mm)) >= 0.0:
        raise InputError(
            f"{source}: cameras: {name} at {list(place.center_mm)} mm: expected it in front of the wall, but it is in the wall or the tank"
        )
    target = np.asarray(place.aim_mm or spec.aim_mm or scene.volume.center_mm)
    camera = Camera(
        name=name,
        rows=spec.rows,
        columns=spec.columns,
        center_mm=place.center_mm,
        rotation=place.rotation or aimed_rotation(np.array([0.0, 0.0, 1.0])),
        principal_distance_mm=spec.focal_length_mm,
        pixel_mm=spec.pixel_mm,
        principal_point_px=((spec.columns - 1) / 2.0, (spec.rows - 1) / 2.0),
        distortion=Distortion(**spec.distortion.model_dump()),
        focal_length_mm=spec.focal_length_mm,
        f_number=spec.f_number,
        wall=wall,
    )
    if place.rotation is None:
        try:
            camera = aim(camera, target)
        except ValueError as error:
            raise InputError(f"{source}: cameras.aim_mm: {error}") from error
    elif np.abs(np.asarray(place.rotation) @ np.asarray(place.rotation).T - np.eye(3)).max() > 1e-9:
        raise InputError(f"{source}: cameras: {name}: rotation: expected an orthonormal matrix")
    elif np.linalg.det(place.rotation) < 0.0:
        raise InputError(
            f"{source}: cameras: {name}: rotation: expected a right-handed matrix, got a mirrored one"
        )
    return _focused(camera, target, spec.focus_mm, source)


def _focused(camera: Camera, target: F64, focus_mm: float | None, source: str) -> Camera:
    """The camera with its image plane where points at `focus_mm`, or else its target, are sharp."""
    focus = focus_mm or apparent_distance_mm(camera, target)
    if not focus > camera.focal_length_mm:
        raise InputError(
            f"{source}: cameras.focus_mm: {camera.name}: expected more than the focal length {camera.focal_length_mm:g} mm, got {focus:.4g}"
        )
    return replace(camera, principal_distance_mm=1.0 / (1.0 / camera.focal_length_mm - 1.0 / focus))


def apparent_distance_mm(camera: Camera, target_mm: F64) -> float:
    """Distance along the axis at which a point in plain air would show the parallax that `target_mm` shows through the wall.

    Refraction makes it astigmatic: the mean over the aperture's two axes is taken.
    """
    plain = replace(camera, distortion=Distortion())
    step = camera.aperture_radius_mm
    moves = []
    for axis, (right, down) in enumerate(((step, 0.0), (0.0, step))):
        there, valid = plain.shifted(right, down).project(target_mm[None])
        back, valid_back = plain.shifted(-right, -down).project(target_mm[None])
        if not (valid[0] and valid_back[0]):
            return float("nan")
        moves.append(abs(there[0, axis] - back[0, axis]) / (2.0 * step * plain.focal_px))
    mean = float(np.mean(moves))
    return 1.0 / mean if mean else float("inf")
