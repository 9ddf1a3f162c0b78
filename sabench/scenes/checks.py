"""Checks of a rig's geometry.

Wall, tank, occluders, backlight and the cameras' views. Each raises an InputError of one sentence
that begins with the scene's key.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Wall
from sabench.geometry.visibility import any_in_view
from sabench.scenes.illumination import Backlight
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError


def check_tank(walls: Sequence[Wall | CylinderWall], corners: F64) -> None:
    """Check that a volume's corners (8, 3) are in the fluid."""
    for wall in walls:
        if isinstance(wall, CylinderWall):
            _check_in_cylinder(wall, corners)
        else:
            _check_behind(wall, corners)


def _check_in_cylinder(wall: CylinderWall, corners: F64) -> None:
    outside = float((wall.thickness_mm - wall.depth_of(corners)).max())
    if outside >= 0.0:
        inner = wall.outer_radius_mm - wall.thickness_mm
        raise InputError(
            f"volume: expected it inside the cylinder's inner face, of radius {inner:g} mm, but it "
            f"reaches {inner + outside:.4g} mm from the axis"
        )


def _check_behind(wall: Wall, corners: F64) -> None:
    """Check that a volume's corners (8, 3) are between a wall and the back wall."""
    depth = wall.depth_of(corners) - wall.thickness_mm
    if depth.min() <= 0.0:
        raise InputError(
            "volume: expected it to lie behind the wall's inner face, "
            f"but it reaches {-depth.min():.4g} mm in front of it"
        )
    if wall.depth_mm is not None and depth.max() > wall.depth_mm:
        raise InputError(
            "volume: expected it to lie in front of the back wall "
            f"(wall.depth_mm = {wall.depth_mm:g}), but it reaches {depth.max():.4g} mm deep"
        )


def check_rotation(matrix: F64, where: str) -> None:
    """Check that a matrix (3, 3) is a rotation."""
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-9:
        raise InputError(f"{where}: expected an orthonormal matrix")
    if np.linalg.det(matrix) < 0.0:
        raise InputError(f"{where}: expected a right-handed matrix, got a mirrored one")


def check_views(cameras: tuple[Camera, ...], corners: F64) -> None:
    """Check that at least one camera sees one of 9 x 9 x 9 points of the volume."""
    steps = np.linspace(0.0, 1.0, 9)
    lattice = corners[0] + np.array(list(itertools.product(steps, repeat=3))) * (
        corners[-1] - corners[0]
    )
    if not any_in_view(cameras, lattice):
        raise InputError(
            "volume: expected it in view of at least one camera, "
            f"but no camera of {len(cameras)} sees any of it"
        )


def check_occluder(
    disc: Disc,
    walls: Sequence[Wall | CylinderWall],
    cameras: tuple[Camera, ...],
    corners: F64,
    where: str,
) -> None:
    """Check that all light to the cameras passes a disc on straight lines."""
    depth = min((_reach(disc, wall) for wall in walls), default=-1.0)
    if depth >= 0.0:
        raise InputError(
            f"{where}: expected it wholly in front of the wall, "
            f"but it reaches {depth:.4g} mm behind the wall's outer face"
        )
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        near, far = (
            end - float(np.dot(camera.center_mm, forward)) for end in disc.span_mm(forward)
        )
        if near <= 0.0:
            raise InputError(
                f"{where}: expected it wholly in front of all cameras, "
                f"but it reaches {-near:.4g} mm behind {camera.name}"
            )
        excess = far - float(((corners - camera.center_mm) @ forward).min())
        if not walls and excess >= 0.0:
            raise InputError(
                f"{where}: expected it wholly between the cameras and the volume, "
                f"but for {camera.name} it reaches {excess:.4g} mm into the volume"
            )


def _reach(disc: Disc, wall: Wall | CylinderWall) -> float:
    """Compute how far a disc reaches behind a wall's outer face, mm."""
    if isinstance(wall, CylinderWall):
        return float(wall.depth_of(disc.points_mm()).max())
    return disc.span_mm(np.asarray(wall.normal))[1] - float(np.dot(wall.point_mm, wall.normal))


def is_beside(disc: Disc, camera: Camera) -> bool:
    """Return whether a disc is on a camera's side of the tank.

    Only there it can hide something. For a cylinder it is the side of the axis.
    """
    wall, center = camera.wall, np.asarray(disc.center_mm)
    if isinstance(wall, CylinderWall):
        from_axis = center - np.asarray(wall.axis_point_mm)
        return float(from_axis @ wall.normal_at(np.asarray(camera.center_mm))) < 0.0
    return wall is None or float(wall.depth_of(center)) < 0.0


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
        if isinstance(wall, Wall):  # any other is refused
            _check_behind_tank(wall, rear_mm, center, where)
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        depth = float((center - camera.center_mm) @ forward)
        far = float(((corners - camera.center_mm) @ forward).max())
        if depth <= far:
            raise InputError(
                f"{where}: expected it behind the volume, {far:.4g} mm before {camera.name}, "
                f"got {depth:.4g} mm"
            )


def _check_behind_tank(wall: Wall, rear_mm: float, center: F64, where: str) -> None:
    if wall.depth_mm is None:
        raise InputError(
            f"{where}: expected wall.depth_mm, the back wall's position, "
            "for light from behind the tank"
        )
    outer = wall.thickness_mm + wall.depth_mm + rear_mm
    depth = float(wall.depth_of(center))
    if depth <= outer:
        raise InputError(
            f"{where}: expected it behind the back wall, {outer:g} mm behind the outer face, "
            f"got {depth:.4g} mm"
        )
