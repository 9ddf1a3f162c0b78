"""Checks of a rig's geometry: wall, tank, occluders, backlight and the cameras' views."""

from __future__ import annotations

import itertools

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.occluders import Disc
from sabench.geometry.refraction import Wall
from sabench.geometry.visibility import any_in_view
from sabench.scenes.scene import Scene
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError


def check_tank(wall: Wall, corners: F64, source: str) -> None:
    depth = wall.depth_of(corners) - wall.thickness_mm
    if depth.min() <= 0.0:
        raise InputError(
            f"{source}: volume: expected it to lie behind the wall's inner face, but it reaches {-depth.min():.4g} mm in front of it"
        )
    if wall.depth_mm is not None and depth.max() > wall.depth_mm:
        raise InputError(
            f"{source}: volume: expected it to lie in front of the back wall (wall.depth_mm = {wall.depth_mm:g}), "
            f"but it reaches {depth.max():.4g} mm deep"
        )


def check_views(cameras: tuple[Camera, ...], corners: F64, source: str) -> None:
    """At least one camera must see some of the volume: a lattice of points over it is tried."""
    steps = np.linspace(0.0, 1.0, 9)
    lattice = corners[0] + np.array(list(itertools.product(steps, repeat=3))) * (
        corners[-1] - corners[0]
    )
    if not any_in_view(cameras, lattice):
        raise InputError(
            f"{source}: volume: expected it in view of at least one camera, but no camera of {len(cameras)} sees any of it"
        )


def check_occluder(
    disc: Disc, wall: Wall | None, cameras: tuple[Camera, ...], corners: F64, where: str
) -> None:
    """A disc must lie where all light on its way to the cameras still comes by, and runs straight."""
    if wall:
        depth = disc.span_mm(np.asarray(wall.normal))[1] - float(np.dot(wall.point_mm, wall.normal))
        if depth >= 0.0:
            raise InputError(
                f"{where}: expected it wholly in front of the wall, but it reaches {depth:.4g} mm behind the wall's outer face"
            )
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        near, far = (
            end - float(np.dot(camera.center_mm, forward)) for end in disc.span_mm(forward)
        )
        if near <= 0.0:
            raise InputError(
                f"{where}: expected it wholly in front of all cameras, but it reaches {-near:.4g} mm behind {camera.name}"
            )
        excess = far - float(((corners - camera.center_mm) @ forward).min())
        if wall is None and excess >= 0.0:
            raise InputError(
                f"{where}: expected it wholly between the cameras and the volume, but for {camera.name} it reaches {excess:.4g} mm into the volume"
            )


def check_backlight(
    scene: Scene, wall: Wall | None, cameras: tuple[Camera, ...], corners: F64, where: str
) -> None:
    """A diffuser must be behind the volume as all cameras see it and, where there is a tank, behind that."""
    assert scene.backlight is not None
    center = np.asarray(scene.backlight.center_mm)
    if wall:
        if wall.depth_mm is None:
            raise InputError(
                f"{where}: expected wall.depth_mm, the back wall's place, for light from behind the tank"
            )
        rear = (scene.wall.rear or ()) if scene.wall else ()
        outer = wall.thickness_mm + wall.depth_mm + sum(layer.thickness_mm for layer in rear)
        depth = float(wall.depth_of(center))
        if depth <= outer:
            raise InputError(
                f"{where}: expected it behind the back wall, {outer:g} mm behind the outer face, got {depth:.4g} mm"
            )
    for camera in cameras:
        forward = np.asarray(camera.rotation[2])
        depth, far = (
            float((center - camera.center_mm) @ forward),
            float(((corners - camera.center_mm) @ forward).max()),
        )
        if depth <= far:
            raise InputError(
                f"{where}: expected it behind the volume, {far:.4g} mm before {camera.name}, got {depth:.4g} mm"
            )
