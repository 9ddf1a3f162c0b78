"""Construction of a rig: walls, aimed and focused cameras, grid, occluders.

Checks raise an InputError of one sentence that begins with the scene's key.
"""

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from sabench.geometry.camera import Camera, aim, aimed_rotation
from sabench.geometry.camera_model import any_in_view, describe_cameras
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.grid import Grid
from sabench.geometry.lens import UPRIGHT, Distortion
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Layer, Wall, trace_to_points
from sabench.geometry.rigid_motion import Domain
from sabench.plotting.card import Card
from sabench.scenes.cameras import ListLayout, Place, offsets_of
from sabench.scenes.focusing import focus, tilt_sensor
from sabench.scenes.illumination import Backlight
from sabench.scenes.scene import Scene
from sabench.scenes.wall import CylinderSpec, WallSpec, WallTable, wall_tables
from sabench.utils.arrays import F64, triple, unit
from sabench.utils.errors import InputError
from sabench.utils.validation import Collector

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
        axis = triple(unit(spec.axis))
        return CylinderWall(spec.axis_point_mm, axis, spec.outer_radius_mm, *media)
    return Wall(spec.point_mm, triple(unit(spec.normal)), *media, spec.depth_mm)


def build_walls(wall: WallTable | None) -> tuple[TankWall, ...]:
    """Build all walls of a tank; none in plain air.

    Raises InputError: walls with different fluids behind them, or a mirroring wall among several.
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

    Raises InputError: a light path that crosses the edge between two walls, or an image of a corner
    on the sensor through another wall.
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


def check_tank(walls: Sequence[Wall | CylinderWall], corners: F64) -> None:
    """Check that a volume's corners (8, 3) are in the fluid."""
    for wall in walls:
        depth = wall.depth_of(corners) - wall.thickness_mm
        if isinstance(wall, CylinderWall):
            inner = wall.outer_radius_mm - wall.thickness_mm
            place = f"inside the cylinder's inner face, of radius {inner:g} mm"
            reach = f"{inner - depth.min():.4g} mm from the axis"
        elif depth.min() <= 0.0 or wall.depth_mm is None:
            place = "to lie behind the wall's inner face"
            reach = f"{-depth.min():.4g} mm in front of it"
        else:
            place = f"to lie in front of the back wall (wall.depth_mm = {wall.depth_mm:g})"
            reach = f"{depth.max():.4g} mm deep"
        back = np.inf if isinstance(wall, CylinderWall) else wall.depth_mm or np.inf
        if depth.min() <= 0.0 or depth.max() > back:
            raise InputError(f"volume: expected it {place}, but it reaches {reach}")


def check_occluder(
    disc: Disc,
    walls: Sequence[Wall | CylinderWall],
    cameras: tuple[Camera, ...],
    corners: F64,
    where: str,
) -> None:
    """Check that all light to the cameras passes a disc on straight lines."""
    depths = [
        float(wall.depth_of(disc.points_mm()).max())
        if isinstance(wall, CylinderWall)
        else disc.span_mm(np.asarray(wall.normal))[1] - float(np.dot(wall.point_mm, wall.normal))
        for wall in walls
    ]
    depth = min(depths, default=-1.0)  # of the disc behind the wall's outer face
    if depth >= 0.0:
        reach = f"{depth:.4g} mm behind the wall's outer face"
        raise InputError(
            f"{where}: expected it wholly in front of the wall, but it reaches {reach}"
        )
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        near, far = (
            end - float(np.dot(camera.center_mm, forward)) for end in disc.span_mm(forward)
        )
        if near <= 0.0:
            reach = f"but it reaches {-near:.4g} mm behind {camera.name}"
            raise InputError(f"{where}: expected it wholly in front of all cameras, {reach}")
        excess = far - float(((corners - camera.center_mm) @ forward).min())
        if not walls and excess >= 0.0:
            place = "wholly between the cameras and the volume"
            reach = f"for {camera.name} it reaches {excess:.4g} mm into the volume"
            raise InputError(f"{where}: expected it {place}, but {reach}")


def check_backlight(
    spec: Backlight,
    walls: Sequence[Wall | CylinderWall],
    rear_mm: float,
    cameras: tuple[Camera, ...],
    corners: F64,
) -> None:
    """Check that a diffuser is behind the volume for all cameras and behind the tank.

    `rear_mm` is the thickness of the back wall.
    """
    center, where = np.asarray(spec.center_mm), "backlight.center_mm"
    for wall in walls:
        if not isinstance(wall, Wall):
            continue  # it is refused
        if wall.depth_mm is None:
            why = "the back wall's position, for light from behind the tank"
            raise InputError(f"{where}: expected wall.depth_mm, {why}")
        outer = wall.thickness_mm + wall.depth_mm + rear_mm
        depth = float(wall.depth_of(center))
        if depth <= outer:
            place = f"behind the back wall, {outer:g} mm behind the outer face"
            raise InputError(f"{where}: expected it {place}, got {depth:.4g} mm")
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        depth = float((center - camera.center_mm) @ forward)
        far = float(((corners - camera.center_mm) @ forward).max())
        if depth <= far:
            place = f"behind the volume, {far:.4g} mm before {camera.name}"
            raise InputError(f"{where}: expected it {place}, got {depth:.4g} mm")


_MOST_CAMERAS = 1000


@dataclass(frozen=True, repr=False)
class Rig(Card):
    """The optics of a scene.

    Attributes
    ----------
    cameras : the true cameras, each with the wall that it looks through.
    grid : the voxels that solvers reconstruct.
    occluders : opaque discs between the cameras and the volume.
    """

    cameras: tuple[Camera, ...]
    grid: Grid
    occluders: tuple[Disc, ...]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield ("Rig",)
        yield "cameras", describe_cameras(self.cameras)
        yield "walls", str(len({camera.wall for camera in self.cameras} - {None}))
        yield "grid", str(self.grid)

    def _picture(self) -> bytes:
        """Draw the cameras and the volume's outline as seen along Y."""
        from sabench.plotting.drawing import Circles, Curve, draw_panel

        (left, _, near), (right, _, far) = self.grid.box_mm
        x, _, z = np.array([camera.center_mm for camera in self.cameras]).T
        cameras = Circles("cameras", x, z, np.full_like(x, 0.02 * float(np.ptp([x, z]))))
        volume = Curve("volume", [left, right, right, left, left], [near, near, far, far, near])
        return draw_panel("X, mm", "Z, mm", cameras, volume)

    def occluders_of(self, camera: Camera) -> tuple[Disc, ...]:
        """Give the occluders on a camera's side of the tank.

        Only there they hide something. For a cylinder it is the side of the axis.
        """
        wall = camera.wall
        if wall is None:
            return self.occluders
        if isinstance(wall, CylinderWall):
            inwards = wall.normal_at(np.asarray(camera.center_mm))
            axis_point = np.asarray(wall.axis_point_mm)
            depths = [float((disc.center_mm - axis_point) @ inwards) for disc in self.occluders]
        else:
            depths = [float(wall.depth_of(np.asarray(disc.center_mm))) for disc in self.occluders]
        both = zip(self.occluders, depths, strict=True)
        return tuple(disc for disc, depth in both if depth < 0.0)


def build_rig(scene: Scene, source: str = "scene") -> Rig:
    """Build and check the rig; `source` is named in errors.

    Raises InputError for all of these: cameras in the wall or the tank or that face two walls, a
    volume that is not wholly in the fluid, a grid that does not fit, a volume that no camera sees,
    occluders that are not between the cameras and the wall (or the volume), a backlight that is not
    behind the volume.
    """
    check, count = Collector(source), scene.cameras.count
    if count > _MOST_CAMERAS:
        expected = f"expected at most {_MOST_CAMERAS} cameras"
        raise InputError(f"{source}: cameras.layout: {expected}, got {count}")
    names = [f"camera_{number:02d}" for number in range(count)]
    check.faults += scene.sensor.faults_by_camera(count)
    check.faults += scene.cameras.faults_by_camera(names)
    check.faults += scene.timing.faults_by_camera(count) if scene.timing else ()
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    corners = np.asarray(scene.volume.center_mm + signs * np.asarray(scene.volume.size_mm))
    with check.collect():
        grid = _build_grid(scene)
    with check.collect():
        if scene.bubbles or scene.solids or scene.backlight:
            check_one_plane(scene)
        walls = build_walls(scene.wall)
        check_tank(walls, corners)  # cameras are aimed at the volume: not built if it fails
        cameras = _build_cameras(scene, walls, corners)
        discs = tuple(
            Disc(spec.center_mm, triple(unit(spec.normal)), spec.radius_mm)
            for spec in scene.occluders or ()
        )
        for number, disc in enumerate(discs):
            with check.collect():
                check_occluder(disc, walls, cameras, corners, f"occluders.{number}")
        if scene.backlight:
            with check.collect():
                thickness = sum(layer.thickness_mm for layer in scene.rear)
                check_backlight(scene.backlight, walls, thickness, cameras, corners)
        steps = np.array(list(itertools.product(np.linspace(0.0, 1.0, 9), repeat=3)))
        lattice = corners[0] + steps * (corners[-1] - corners[0])
        if not check.faults and not any_in_view(cameras, lattice):
            seen = f"but no camera of {len(cameras)} sees any of it"
            raise InputError(f"volume: expected it in view of at least one camera, {seen}")
    check.finish()
    return Rig(cameras, grid, discs)


def _build_grid(scene: Scene) -> Grid:
    """Fill the volume with voxels; their number along each axis is rounded."""
    size, voxel, crop = (
        np.asarray(v) for v in (scene.volume.size_mm, scene.grid.voxel_mm, scene.grid.crop_mm)
    )
    counts = np.maximum(1, np.rint(size / voxel).astype(int))
    cut = np.rint(crop / voxel).astype(int)
    if np.any(2 * cut >= counts):
        expected = f"expected less than half of volume.size_mm, got {list(scene.grid.crop_mm)}"
        raise InputError(f"grid.crop_mm: {expected}")
    low = np.asarray(scene.volume.center_mm) - (counts - 1) / 2.0 * voxel
    (x, y, z), (a, b, c) = counts.tolist(), cut.tolist()
    return Grid(triple(low), scene.grid.voxel_mm, (z, y, x), (a, b, c))


def domain_of(scene: Scene) -> Domain:
    """Give the volume that the scene's generators fill."""
    return Domain(
        scene.volume.center_mm, scene.volume.size_mm, scene.cameras.rows * scene.cameras.columns
    )


def _build_cameras(scene: Scene, walls: tuple[TankWall, ...], corners: F64) -> tuple[Camera, ...]:
    cameras, check, array = [], Collector(""), scene.cameras
    if isinstance(array.layout, ListLayout):
        places = list(array.layout.places)
    else:
        axes = np.stack([unit(array.x_axis), unit(array.y_axis)])
        centers = np.asarray(array.center_mm) + offsets_of(array.layout) @ axes
        places = [Place(center_mm=triple(center)) for center in centers]
    for number, place in enumerate(places):
        with check.collect():
            camera = _build_camera(scene, walls, f"camera_{number:02d}", place)
            if len(walls) > 1:
                check_one_face(camera, walls, corners)
            cameras.append(camera)
    kinds: dict[str, list[str]] = {}  # faults that differ by numbers only
    for fault in check.faults:
        kinds.setdefault(re.sub(r"[-+.\de]+", "", fault), []).append(fault)
    check.faults = [
        same[0] if len(same) == 1 else f"{same[0]} (and {len(same) - 1} more cameras)"
        for same in kinds.values()
    ]
    check.finish()
    return tuple(cameras)


def _build_camera(scene: Scene, walls: tuple[TankWall, ...], name: str, place: Place) -> Camera:
    (spec, camera_spec), center = scene.cameras.of_camera(name), np.asarray(place.center_mm)
    if walls and not min(float(wall.depth_of(center)) for wall in walls) < 0.0:
        raise InputError(
            f"cameras: {name} at {list(place.center_mm)} mm: expected it in front of the wall, "
            "but it is in the wall or the tank"
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
        principal_point_px=camera_spec.principal_point_px
        or ((spec.columns - 1) / 2.0, (spec.rows - 1) / 2.0),
        distortion=Distortion(**spec.distortion.model_dump()),
        focal_length_mm=spec.focal_length_mm,
        f_number=spec.f_number,
        wall=wall_towards(walls, center, target),
        tilt_deg=camera_spec.tilt_deg or UPRIGHT,
    )
    if place.rotation is None:
        try:
            camera = aim(camera, target)
        except ValueError as error:
            raise InputError(f"cameras.aim_mm: {error}") from error
    else:
        matrix, where = np.asarray(place.rotation), f"cameras: {name}: rotation"
        if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-9:
            raise InputError(f"{where}: expected an orthonormal matrix")
        if np.linalg.det(matrix) < 0.0:
            raise InputError(f"{where}: expected a right-handed matrix, got a mirrored one")
    camera = focus(camera, target, spec.focus_mm)
    if camera_spec.tilt_deg is None and spec.focus_normal is not None:
        return tilt_sensor(camera, target, unit(spec.focus_normal))
    return camera
