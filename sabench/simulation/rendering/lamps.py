"""Lamps at their apparent positions in the fluid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import AnyWall, Wall
from sabench.scenes.illumination import Lighting
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Lamps:
    """Lamps in the frame of the render.

    `positions` (n, 3); `powers` (n,), where 1 gives a white surface that faces the lamp at 1 mm a
    radiance of 1; `ambient` is uniform light from all directions.
    comes evenly from everywhere.
    """

    positions: F64
    powers: F64
    ambient: float


def place_lamps(
    lighting: Lighting, camera: Camera, center_mm: F64, origin: F64, scale: float = 1.0
) -> Lamps:
    """Build lamps that give a white surface at the centre its exposure.

    The surface faces the wall; ambient light is included and all powers are multiplied by `scale`.
    """
    facing = facing_of(camera)
    positions = np.array(
        [_find_apparent(camera.wall, np.asarray(lamp.center_mm)) for lamp in lighting.lamps]
    )
    powers = np.array([lamp.power for lamp in lighting.lamps])
    directions = positions - center_mm
    lengths = np.linalg.norm(directions, axis=1)
    there = float(np.sum(powers * np.maximum(-(directions @ facing), 0.0) / lengths**3))
    ambient = lighting.even or 0.0
    return Lamps(
        positions - origin,
        (1.0 - ambient) * lighting.exposure * scale * powers / max(there, 1e-300),
        ambient * lighting.exposure * scale,
    )


def facing_of(camera: Camera) -> F64:
    """Return the unit vector (3,) into the wall, or without one along the axis."""
    if camera.wall is None:
        return np.asarray(camera.rotation[2])
    return camera.wall.normal_at(np.asarray(camera.center_mm))


def _find_apparent(wall: AnyWall | None, lamp_mm: F64) -> F64:
    """Find the apparent position of a lamp for rays that cross a plane wall steeply.

    A lamp in the fluid stays where it is, and so does one in front of a cylinder.
    """
    before = -float(wall.depth_of(lamp_mm)) if wall else 0.0
    if not isinstance(wall, Wall) or before <= 0.0:
        return lamp_mm
    indices = wall.indices
    optical = before / indices[0] + sum(layer.thickness_mm / layer.index for layer in wall.layers)
    return np.asarray(
        lamp_mm + (before + wall.thickness_mm - optical * indices[-1]) * np.asarray(wall.normal)
    )
