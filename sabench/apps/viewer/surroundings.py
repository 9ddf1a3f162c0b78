"""Rig as pages draw it: cameras and their frusta, walls, light and volume.

The page of a view draws it in space by a script, and drawings along two edges of the volume need
none.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from sabench.apps.viewer.outlines import Outline, draw_outlines
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import SIDE, border_pixels, light_paths
from sabench.geometry.cylinder_wall import CylinderWall, WallRecord
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.scenes.illumination import Backlight, Illumination
from sabench.utils.arrays import F64

_SHARPEST = 0.3  # sine of the angle of two faces that are drawn up to their edge
_MARGIN = 0.04  # drawn margin of a wall beyond the light paths through it
_DECIMALS = 4


@dataclass(frozen=True)
class Surroundings:
    """Cameras, walls, light and occluders around the particles.

    Attributes
    ----------
    low_mm, high_mm : (3,) corners of the volume.
    scored_mm : corners (2, 3) of the part that scores see.
    light : in the fluid, behind its window.
    estimated : cameras that a solver has calibrated.
    faces : all walls of the tank, some of which no camera looks through.
    """

    cameras: tuple[CameraModel, ...]
    low_mm: F64
    high_mm: F64
    scored_mm: F64
    light: Illumination | None = None
    backlight: Backlight | None = None
    occluders: tuple[Disc, ...] = ()
    estimated: tuple[CameraModel, ...] = ()
    faces: tuple[WallRecord, ...] = ()

    @property
    def center_mm(self) -> F64:
        """Middle (3,) of the volume."""
        return np.asarray((self.low_mm + self.high_mm) / 2.0)

    def frustum(self, camera: CameraModel) -> F64:
        """Follow the light paths of the border of a camera's image; see `light_paths`."""
        return light_paths(camera, border_pixels(camera), self.low_mm, self.high_mm)

    @property
    def walls(self) -> tuple[WallRecord, ...]:
        """Walls that the cameras look through, and all that are known, each once."""
        walls = [camera.wall for camera in self.cameras if isinstance(camera, Camera)]
        return tuple(dict.fromkeys(wall for wall in (*walls, *self.faces) if wall is not None))

    def describe(self) -> dict[str, Any]:
        """Describe everything as the page's JSON holds it; lengths in mm."""
        return {
            "cameras": [self._describe_camera(camera) for camera in self.cameras],
            "estimated": [self._describe_camera(camera) for camera in self.estimated],
            "side": SIDE,
            "volume": rounded([self.low_mm, self.high_mm]),
            "scored": rounded(self.scored_mm),
            "walls": [_describe_wall(wall, self._points_at(wall)) for wall in self.walls],
            "sheet": None if self.light is None else self._describe_light(self.light),
            "backlight": None if self.backlight is None else _describe_plate(self.backlight),
            "discs": [
                {"center": disc.center_mm, "normal": disc.normal, "radius": disc.radius_mm}
                for disc in self.occluders
            ],
        }

    def _describe_camera(self, camera: CameraModel) -> dict[str, Any]:
        return {
            "name": camera.name,
            "rows": camera.rows,
            "columns": camera.columns,
            "center": rounded(camera.center_mm),
            "axes": rounded(camera_axes(camera), 6),
            "paths": rounded(self.frustum(camera)),
        }

    def _points_at(self, wall: WallRecord) -> F64:
        """Collect points (n, 3) on or behind a wall that its drawing has to reach."""
        paths = [
            self.frustum(camera)[:, 1:-1].reshape(-1, 3)
            for camera in self.cameras
            if isinstance(camera, Camera) and camera.wall == wall
        ]
        corners = np.array([self.low_mm, self.high_mm, self.center_mm])
        points = np.concatenate([*paths, corners])
        points = points[np.isfinite(points).all(axis=1)]
        if not isinstance(wall, Wall):
            return np.asarray(points)
        edges = [_slide(points, wall, one) for one in self.walls if isinstance(one, Wall)]
        return np.concatenate([points, *edges])

    def _describe_light(self, light: Illumination) -> dict[str, Any]:
        """Describe the light as a box that is as long as the volume."""
        normal, along = (
            np.asarray(axis) / np.linalg.norm(axis)
            for axis in (light.sheet_normal, light.direction)
        )
        length = float(np.abs(along) @ (self.high_mm - self.low_mm))
        return {
            "center": rounded(self.center_mm + normal * (light.shift_mm or 0.0)),
            "axes": rounded([along, np.cross(normal, along), normal], 6),
            "size": rounded([length, light.height_mm, light.thickness_mm]),
            "along": rounded(along, 6),
        }


def camera_axes(camera: CameraModel) -> F64:
    """Return the camera's right, down and forward axes (3, 3) in the world, as rows."""
    if isinstance(camera, Camera):
        return np.asarray(camera.rotation)
    middle = np.array([[(camera.columns - 1) / 2.0, (camera.rows - 1) / 2.0]])
    return np.asarray(aimed_rotation(camera.back_project(middle).directions[0]))


def _describe_wall(wall: WallRecord, points_mm: F64) -> dict[str, Any]:
    """Describe a wall as far as points (n, 3) reach."""
    if isinstance(wall, CylinderWall):
        return _describe_cylinder(wall, points_mm)
    across = frame_of_normal(np.asarray(wall.normal))[:2]
    low, high = _padded((points_mm - np.asarray(wall.point_mm)) @ across.T)
    depths = [float(depth) for depth in wall.interface_depths_mm]
    # compute the depth of the back wall behind the outer face
    return {
        "kind": "plane",
        "point": rounded(wall.point_mm),
        "normal": rounded(wall.normal, 6),
        "axes": rounded(across, 6),
        "low": rounded(low),
        "high": rounded(high),
        "depths": rounded(depths),
        "back": (
            None if wall.depth_mm is None else round(wall.thickness_mm + wall.depth_mm, _DECIMALS)
        ),
        "media": _media(wall),
    }


def _slide(points_mm: F64, wall: Wall, other: Wall) -> F64:
    """Slide points (n, 3) along a wall to its edge with another; none if flat."""
    normal, far = np.asarray(wall.normal), np.asarray(other.normal)
    along = far - (far @ normal) * normal
    if np.linalg.norm(along) < _SHARPEST:
        return np.zeros((0, 3))
    off = (points_mm - np.asarray(other.point_mm)) @ far
    depth = (points_mm - np.asarray(wall.point_mm)) @ normal
    flat = points_mm - depth[:, None] * normal
    off = off - depth * float(normal @ far)
    return np.asarray(flat - (off / (along @ far))[:, None] * along)


def _describe_cylinder(wall: CylinderWall, points_mm: F64) -> dict[str, Any]:
    along = ((points_mm - np.asarray(wall.axis_point_mm)) @ np.asarray(wall.axis))[:, None]
    (low,), (high,) = _padded(along)
    return {
        "kind": "cylinder",
        "point": rounded(wall.axis_point_mm),
        "axis": rounded(wall.axis, 6),
        "radii": rounded(wall.radii_mm),
        "low": round(float(low), _DECIMALS),
        "high": round(float(high), _DECIMALS),
        "media": _media(wall),
    }


def _media(wall: WallRecord) -> list[str]:
    """List the media along a light path, with their refractive indices."""
    layers = [f"{layer.name}, n = {layer.index:g}" for layer in wall.layers]
    return [f"n = {wall.air_index:g}", *layers, f"fluid, n = {wall.fluid_index:g}"]


def _describe_plate(plate: Backlight) -> dict[str, Any]:
    normal = np.asarray(plate.normal) / np.linalg.norm(plate.normal)
    first = np.asarray(plate.x_axis) - (np.asarray(plate.x_axis) @ normal) * normal
    first = first / np.linalg.norm(first)
    axes = [first, np.cross(normal, first), normal]
    return {
        "center": rounded(plate.center_mm),
        "axes": rounded(axes, 6),
        "size": rounded(plate.size_mm),
    }


def _padded(values: F64) -> tuple[F64, F64]:
    """Find the ends of values (n, axes), with a margin."""
    low, high = values.min(axis=0), values.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    return low - margin, high + margin


def rounded(values: npt.ArrayLike, decimals: int = _DECIMALS) -> Any:
    """Convert an array to nested lists of short numbers; NaN becomes None."""
    array = np.round(np.asarray(values, dtype=np.float64), decimals) + 0.0
    objects = array.astype(object)
    objects[~np.isfinite(array)] = None
    return objects.tolist()


# margins around the rig and the volume, and size of a camera, share of the drawing's larger side
_AROUND, _NEAR, _CAMERA = 0.06, 0.6, 0.03
_NAMES = ("x", "y", "z")
_ARC = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]


def draw_surroundings(around: Surroundings, *, near: bool = False) -> list[tuple[str, str]]:
    """Draw a rig, or its volume alone, twice: pairs of a title and an SVG element.

    Each drawing is a projection along an edge of the volume.
    """
    rig = around.describe()
    centers = np.array([camera.center_mm for camera in around.cameras])
    axis = int(np.argmax(np.abs(centers.mean(axis=0) - around.center_mm)))
    planes = [[axis, vertical] for vertical in range(3) if vertical != axis]
    return [_draw(rig, plane, near=near) for plane in planes]


def _draw(rig: dict[str, Any], plane: list[int], *, near: bool) -> tuple[str, str]:
    """Draw everything in a plane of two axes."""
    shapes = [Outline("volume", _hull(_corners(rig), plane), closed=True)]
    volume = shapes[0].points_mm
    for wall in rig["walls"]:
        faces = _faces(wall, rig["walls"])
        shapes += [Outline("wall", _hull(face, plane), closed=True) for face in faces]
    ends = np.concatenate([shape.points_mm for shape in shapes])
    for camera in rig["cameras"]:
        shapes += [Outline("ray", path[:, plane]) for path in _edges(camera, rig["side"])]
    if not near:
        ends = np.concatenate([shape.points_mm for shape in shapes])
    share = _NEAR if near and not rig["walls"] else _AROUND
    margin = share * float(np.ptp(ends, axis=0).max())
    low, high = ends.min(axis=0) - margin, ends.max(axis=0) + margin
    length = _CAMERA * float((high - low).max())
    shapes += [_symbol(camera, plane, length) for camera in rig["cameras"]]
    if rig["sheet"] is not None:
        half, axes = np.array(rig["sheet"]["size"]) / 2.0, np.array(rig["sheet"]["axes"])
        ends = rig["sheet"]["center"] + _box(-half, half) @ axes
        shapes.append(Outline("sheet", _hull(ends, plane), closed=True))
    names = _NAMES[plane[0]], _NAMES[plane[1]]
    size = " x ".join(f"{edge:.4g}" for edge in np.ptp(volume, axis=0))
    title = f"{f'Volume of {size} mm' if near else 'Rig'}, {names[0]} and {names[1]}"
    return title, draw_outlines(title, shapes, low, high, names)


def _corners(rig: dict[str, Any]) -> F64:
    return _box(*np.array(rig["volume"]))


def _box(low: F64, high: F64) -> F64:
    """List the corners (8, 3) of a box."""
    return np.array(list(itertools.product(*zip(low, high, strict=True))))


def _faces(wall: dict[str, Any], walls: Sequence[dict[str, Any]]) -> Iterator[F64]:
    """Yield points (n, 3) at the rim of each face, cut by the faces of other walls."""
    if wall["kind"] == "plane":
        ends = np.array([wall["low"], wall["high"]])
        across = np.array(list(itertools.product(*ends.T))) @ np.array(wall["axes"])
        for number, depth in enumerate(wall["depths"]):
            points = wall["point"] + across + depth * np.array(wall["normal"])
            for other in (one for one in walls if one["kind"] == "plane" and one is not wall):
                points = _cut(points, other, other["depths"][: number + 1][-1])
            yield points
        return
    axis = np.array(wall["axis"])
    first = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 else [1.0, 0.0, 0.0])
    first = first / np.linalg.norm(first)
    around = np.cos(_ARC) * first + np.sin(_ARC) * np.cross(axis, first)
    for radius in wall["radii"]:
        rims = [radius * around + end * axis for end in (wall["low"], wall["high"])]
        yield wall["point"] + np.concatenate(rims)


def _cut(points_mm: F64, wall: dict[str, Any], depth_mm: float) -> F64:
    """Cut the hull of points (n, 3) at a depth behind a wall; one before it stays."""
    off = (points_mm - wall["point"]) @ np.array(wall["normal"]) - depth_mm
    if not (off > 0.0).any():
        return points_mm
    ends = itertools.product(np.flatnonzero(off >= 0.0), np.flatnonzero(off < 0.0))
    cuts = [(off[i] * points_mm[j] - off[j] * points_mm[i]) / (off[i] - off[j]) for i, j in ends]
    return np.array([*points_mm[off >= 0.0], *cuts])


def _edges(camera: dict[str, Any], side: int) -> Iterator[F64]:
    """Yield the light paths (n, 3) of an image's corners."""
    for path in camera["paths"][::side]:
        if path[0][0] is not None:
            yield np.array(path)


def _symbol(camera: dict[str, Any], plane: list[int], length_mm: float) -> Outline:
    """Draw a camera as a triangle with its tip at the pinhole."""
    tip, forward = np.array(camera["center"])[plane], np.array(camera["axes"][2])[plane]
    side = np.array([-forward[1], forward[0]])
    back = tip - length_mm * forward
    half = length_mm / 2.0 * side
    return Outline("camera", np.array([tip, back + half, back - half]), closed=True)


def _hull(points_mm: F64, plane: list[int]) -> F64:
    """Find the rim (n, 2) of points (n, 3) in a plane, or the ends of a line."""
    flat = points_mm[:, plane]
    try:
        return np.asarray(flat[ConvexHull(flat).vertices])
    except QhullError:
        order = np.lexsort(flat.T)
        return np.asarray(flat[order[[0, -1]]])
