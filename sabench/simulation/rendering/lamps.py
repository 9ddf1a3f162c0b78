"""Laser sheet and lamps: light of a pulse, and apparent positions."""

from dataclasses import dataclass

import numpy as np
from scipy.constants import c, h

from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer, Wall, trace_into_fluid, transmittance
from sabench.geometry.rigid_motion import cross
from sabench.scenes.illumination import Illumination, Lighting
from sabench.utils.arrays import F64, triple, unit
from sabench.utils.errors import InputError

_FAR_MM = 1e5


def fluence(light: Illumination, center_mm: F64, positions_mm: F64) -> F64:
    """Compute photons per mm2 of one pulse at positions (n, 3) in a sheet.

    Across the sheet and along its height, a top-hat spreads the energy evenly and is zero outside;
    a gaussian is exp(-8 s^2 / w^2) with the e^-2 width w, and the same energy. A uniform height is
    that of an unlimited top-hat.
    """
    normal, along = unit(light.sheet_normal), unit(light.direction)
    offset = positions_mm - center_mm
    across = offset @ normal - (light.shift_mm or 0.0)
    height = offset @ cross(normal, along)
    photons = light.pulse_energy_mj / (h * c / (light.wavelength_nm * 1e-9) * 1e3)
    return np.asarray(
        photons
        * _profile(light.profile, across, light.thickness_mm)
        * _profile(light.height_profile, height, light.height_mm)
    )


def _profile(kind: str | None, offset_mm: F64, width_mm: float) -> F64 | float:
    """Compute a profile's density (n,), 1/mm."""
    if kind is None:  # even
        return 1.0 / width_mm
    if kind == "top-hat":
        return np.where(np.abs(offset_mm) <= width_mm / 2.0, 1.0 / width_mm, 0.0)
    return np.asarray(np.exp(-8.0 * (offset_mm / width_mm) ** 2) * np.sqrt(8.0 / np.pi) / width_mm)


def enter_fluid(light: Illumination, center_mm: F64, fluid_index: float) -> Illumination:
    """Refract a sheet at its window; without a window, it is in the fluid already.

    All its light has one direction before and behind the window. Its cut with the window keeps its
    place and length, which gives the sheet's plane, thickness and height in the fluid.

    Raises InputError for a sheet that does not reach the window from the outside, or a volume's
    centre outside it.
    """
    if light.entry is None:
        return light
    window = light.entry
    layers = tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in window.layers)
    facing = triple(unit(window.normal))
    wall = Wall(window.point_mm, facing, window.air_index, layers, fluid_index)
    inward, along = np.asarray(wall.normal), unit(light.direction)
    normal = unit(light.sheet_normal)
    start = center_mm + normal * (light.shift_mm or 0.0) - _FAR_MM * along
    rays = trace_into_fluid(wall, start, along[None])
    if not rays.valid[0] or (center_mm - rays.origins_mm[0]) @ inward <= 0.0:
        raise InputError(
            "illumination.entry: expected a window between the laser and the volume, which its "
            f"light reaches from outside, got {window.point_mm} with the normal {window.normal}"
        )
    inside = rays.directions[0]
    line, plane = _cut(inward, normal, along), inward
    level = cross(plane, line)  # in the window, across the sheet's cut
    turned = cross(inside, line)
    turned *= np.sign(turned @ normal) / np.linalg.norm(turned)
    passed = float(transmittance(wall, start, along[None])[0])
    update = {
        "direction": triple(inside),
        "sheet_normal": triple(turned),
        "thickness_mm": light.thickness_mm * abs(float((turned @ level) / (normal @ level))),
        "height_mm": light.height_mm
        * abs(float((cross(turned, inside) @ line) / (cross(normal, along) @ line))),
        "shift_mm": float((rays.origins_mm[0] - center_mm) @ turned),
        "pulse_energy_mj": light.pulse_energy_mj * passed,
        "polarisation": _turn(light.polarisation, inward, along, inside),
        "entry": None,
    }
    return light.model_copy(update=update)


def _cut(inward: F64, normal: F64, along: F64) -> F64:
    """Return the unit vector along the intersection of a sheet and the window."""
    line = cross(inward, normal)
    length = float(np.linalg.norm(line))
    if length < 1e-9:  # the sheet's plane is the window's: light never enters
        line, length = cross(normal, along), 1.0
    return np.asarray(line / length)


def _turn(
    field: tuple[float, float, float] | None, inward: F64, along: F64, inside: F64
) -> tuple[float, float, float] | None:
    """Turn the electric field with the light.

    Its share in the plane of incidence is kept.
    """
    if field is None:
        return None
    axis = cross(along, inward)
    if np.linalg.norm(axis) < 1e-12:
        return field
    axis /= np.linalg.norm(axis)
    part = float(np.asarray(field) @ cross(axis, along))
    return triple(float(np.asarray(field) @ axis) * axis + part * cross(axis, inside))


@dataclass(frozen=True)
class Lamps:
    """Lamps in the frame of the render.

    `positions` (n, 3); `powers` (n,), where 1 gives a white surface that faces the lamp at 1 mm a
    radiance of 1; `ambient` is uniform light from all directions.
    """

    positions: F64
    powers: F64
    ambient: float


def place_lamps(
    lighting: Lighting, camera: Camera, center_mm: F64, origin: F64, scale: float = 1.0
) -> Lamps:
    """Build lamps that give a white surface at the centre its exposure.

    The surface faces the wall; ambient light is included and all powers are multiplied by `scale`.
    Lamps in the fluid, and those in front of a cylinder, have no other apparent position.
    """
    facing = facing_of(camera)
    wall, places = camera.wall, []
    for lamp in lighting.lamps:
        place = np.asarray(lamp.center_mm)
        before = -float(wall.depth_of(place)) if wall else 0.0
        if isinstance(wall, Wall) and before > 0.0:  # the apparent one, for steep rays
            layers = sum(layer.thickness_mm / layer.index for layer in wall.layers)
            optical = before / wall.indices[0] + layers
            shift = before + wall.thickness_mm - optical * wall.indices[-1]
            place = place + shift * np.asarray(wall.normal)
        places.append(place)
    positions = np.array(places)
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
