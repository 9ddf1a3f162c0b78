"""Lamps where the fluid sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Wall
from sabench.scenes.illumination import Lighting
from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Lamps:
    """Where light comes from: places (n, 3) in the frame of the render, power, 1 for a white surface that faces it at a distance of 1 mm, and what
    comes evenly from everywhere."""

    places: F64
    powers: F64
    even: float


def placed(
    lighting: Lighting, camera: Camera, center_mm: F64, origin: F64, scale: float = 1.0
) -> Lamps:
    """Lamps whose powers add up to the exposure, times `scale`, of a white surface at the centre that faces the wall, even light included."""
    facing = np.asarray(camera.wall.normal if camera.wall else camera.rotation[2])
    places = np.array(
        [_apparent(camera.wall, np.asarray(lamp.center_mm)) for lamp in lighting.lamps]
    )
    powers = np.array([lamp.power for lamp in lighting.lamps])
    ways = places - center_mm
    lengths = np.linalg.norm(ways, axis=1)
    there = float(np.sum(powers * np.maximum(-(ways @ facing), 0.0) / lengths**3))
    even = lighting.even or 0.0
    return Lamps(
        places - origin,
        (1.0 - even) * lighting.exposure * scale * powers / max(there, 1e-300),
        even * lighting.exposure * scale,
    )


def _apparent(wall: Wall | None, lamp_mm: F64) -> F64:
    """Where a lamp in front of the wall seems to be for rays that cross the wall steeply; a lamp in the fluid is where it is."""
    before = -float(wall.depth_of(lamp_mm)) if wall else 0.0
    if wall is None or before <= 0.0:
        return lamp_mm
    indices = wall.indices
    optical = before / indices[0] + sum(layer.thickness_mm / layer.index for layer in wall.layers)
    return np.asarray(
        lamp_mm + (before + wall.thickness_mm - optical * indices[-1]) * np.asarray(wall.normal)
    )
