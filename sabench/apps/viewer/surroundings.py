"""Rig as the page draws it: cameras and their frusta, walls, light and volume."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import SIDE, border_pixels, light_paths
from sabench.geometry.cylinder_wall import CylinderWall, WallRecord
from sabench.geometry.occluders import Disc
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.scenes.illumination import Backlight, Illumination
from sabench.utils.arrays import F64

_MARGIN = 0.04  # drawn margin of a wall beyond the light paths through it
_BEYOND = 1.3  # length of the light over the volume's
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
    """

    cameras: tuple[CameraModel, ...]
    low_mm: F64
    high_mm: F64
    scored_mm: F64
    light: Illumination | None = None
    backlight: Backlight | None = None
    occluders: tuple[Disc, ...] = ()
    estimated: tuple[CameraModel, ...] = ()

    @property
    def center_mm(self) -> F64:
        """Middle (3,) of the volume."""
        return np.asarray((self.low_mm + self.high_mm) / 2.0)

    def frustum(self, camera: CameraModel) -> F64:
        """Follow the light paths of the border of a camera's image; see `light_paths`."""
        return light_paths(camera, border_pixels(camera), self.low_mm, self.high_mm)

    @property
    def walls(self) -> tuple[WallRecord, ...]:
        """Walls that the cameras look through, each once."""
        walls = [camera.wall for camera in self.cameras if isinstance(camera, Camera)]
        return tuple(dict.fromkeys(wall for wall in walls if wall is not None))

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
        return np.asarray(points[np.isfinite(points).all(axis=1)])

    def _describe_light(self, light: Illumination) -> dict[str, Any]:
        """Describe the light as a box that is longer than the volume."""
        normal, along = (
            np.asarray(axis) / np.linalg.norm(axis)
            for axis in (light.sheet_normal, light.direction)
        )
        length = _BEYOND * float(np.abs(along) @ (self.high_mm - self.low_mm))
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
