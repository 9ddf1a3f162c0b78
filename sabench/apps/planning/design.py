"""Design of a scene for a wanted depth, density and resolution."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.apps.planning.plan import plan
from sabench.apps.planning.viewing import Viewing, view
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_STEPS = 20  # of the search for a distance
_CLOSE = 1e-4  # relative error of the resolution
_SCORED = 0.99  # share of the scored volume that all cameras should see
_LENGTHS = ("spacing_mm", "radius_mm", "x_mm", "y_mm")  # of layouts
_DENSITIES = ("count", "per_mm3", "per_pixel")

Values = dict[str, Any]


@dataclass(frozen=True)
class Wanted:
    """Wanted volume.

    Attributes
    ----------
    depth_mm : length of the volume along the lines of sight.
    per_mm3 : particles per mm3.
    pixel_mm : width of the innermost camera's pixel at the middle of the volume.
    """

    depth_mm: float
    per_mm3: float
    pixel_mm: float

    def __post_init__(self) -> None:
        """Check the numbers; the names in errors are those of the command's options."""
        given = {"depth": self.depth_mm, "density": self.per_mm3, "resolution": self.pixel_mm}
        for option, value in given.items():
            if not 0.0 < value < math.inf:
                raise InputError(f"--{option}: expected a positive number, got {value:g}")


def design_scene(base: Scene, wanted: Wanted) -> Scene:
    """Change a scene of particles to another depth, density and resolution.

    Sensors, lenses, arrangement and angles of the cameras, wall and flow stay those of the base.
    The cameras move along their viewing direction, the volume keeps its share of the images, the
    f-number rises where the depth of field would be too small, the laser gives as many electrons
    as in the base, and the margin that scores leave out is what not all cameras see.

    Raises
    ------
    InputError
        A base without particles of a given density, with cameras at listed places or behind more
        than one plane wall, or a wanted scene that cannot be built.
    """
    given = base.particle_world.particles
    if not any(key in given for key in _DENSITIES):
        raise InputError(
            f"{base.title}: particles.generator: expected one with per_mm3, got "
            f"{given['generator']}"
        )
    if base.cameras.layout.kind == "list":
        raise InputError(
            f"{base.title}: cameras.layout.kind: expected grid, ring, line or cross to scale, got "
            "list"
        )
    if base.walls and base.plane is None:
        raise InputError(f"{base.title}: wall: expected one plane wall or none to move")
    electrons = _figure(base, "peak_e")
    viewing = view(base, build_rig(base, base.title))
    start = _with_volume(base, viewing, wanted)
    values = _move_cameras(start, viewing, wanted, base)
    # choose the f-number with the wanted depth of field, or the base's. The depth of field grows
    # with its square
    scene = _scene(values)
    field = _figure(scene, "depth_of_field_mm")
    values["cameras"]["f_number"] = scene.cameras.f_number * max(
        1.0, math.sqrt(wanted.depth_mm / field)
    )
    values["illumination"]["pulse_energy_mj"] *= electrons / _figure(_scene(values), "peak_e")
    return _scene(_with_crop(values, viewing, wanted))


def _scene(values: Mapping[str, Any]) -> Scene:
    return parse_scene(dict(values), "wanted scene")


def _figure(scene: Scene, key: str) -> float:
    figures = {one.key: one.value for part in plan(scene).sections for one in part.quantities}
    value = figures.get(key)
    if not value:
        raise InputError(f"{scene.title}: illumination: expected light on the particles, got none")
    return value


def _with_volume(base: Scene, viewing: Viewing, wanted: Wanted) -> Values:
    """Change volume, voxels, density, light and the wall's position."""
    values, ratio = base.to_dict(), wanted.pixel_mm / viewing.pixel_mm(0.5)
    deeper = wanted.depth_mm - viewing.depth_mm
    size = [edge * ratio for edge in base.volume.size_mm]
    size[viewing.axis] = wanted.depth_mm
    values["title"] = (
        f"{wanted.depth_mm:g} mm deep, {wanted.per_mm3:g} particles per mm3, "
        f"{wanted.pixel_mm:g} mm per pixel, after: {base.title}"
    )
    values["volume"]["size_mm"] = size
    values["grid"]["voxel_mm"] = [edge * ratio for edge in base.grid.voxel_mm]
    values["grid"]["crop_mm"] = [0.0, 0.0, 0.0]
    if base.plane is not None:
        moved = np.asarray(base.plane.point_mm) - deeper / 2.0 * viewing.forward
        values["wall"]["point_mm"] = moved.tolist()
        if base.plane.depth_mm is not None:
            values["wall"]["depth_mm"] = max(base.plane.depth_mm + deeper, 1.01 * wanted.depth_mm)
    grown = max(wanted.depth_mm / viewing.depth_mm, ratio)
    for key in ("thickness_mm", "height_mm"):
        values["illumination"][key] *= grown
    for key in _DENSITIES:
        values["particles"].pop(key, None)
    values["particles"]["per_mm3"] = wanted.per_mm3
    return values


def _move_cameras(values: Values, viewing: Viewing, wanted: Wanted, base: Scene) -> Values:
    """Move the cameras back or forth until a pixel has the wanted width."""
    middle, place = viewing.center_mm, np.asarray(base.cameras.center_mm)
    scale = wanted.pixel_mm / viewing.pixel_mm(0.5)
    for _ in range(_STEPS):
        moved = _scaled(values, base, middle, place, scale)
        scene = _scene(moved)
        got = view(scene, build_rig(scene, "wanted scene")).pixel_mm(0.5)
        if abs(got / wanted.pixel_mm - 1.0) < _CLOSE:
            return moved
        scale *= wanted.pixel_mm / got
    raise InputError(
        f"--resolution: expected one that this lens reaches, got {wanted.pixel_mm:g} mm per pixel"
    )


def _scaled(values: Values, base: Scene, middle: F64, place: F64, scale: float) -> Values:
    """Scale the distances of the cameras from the volume and from each other."""
    moved = copy.deepcopy(values)
    moved["cameras"]["center_mm"] = (middle + scale * (place - middle)).tolist()
    layout = moved["cameras"]["layout"]
    for key in _LENGTHS:
        if key in layout:
            lengths = layout[key]
            many = isinstance(lengths, list)
            layout[key] = [one * scale for one in lengths] if many else lengths * scale
    if base.cameras.focus_mm is not None:
        moved["cameras"]["focus_mm"] = base.cameras.focus_mm * scale
    return moved


def _with_crop(values: Values, viewing: Viewing, wanted: Wanted) -> Values:
    """Widen the margin sideways until all cameras see what it leaves."""
    across = [edge for edge in range(3) if edge != viewing.axis]
    size = values["volume"]["size_mm"]
    for share in np.arange(0.0, 0.45, 0.05):
        cropped = copy.deepcopy(values)
        for edge in across:
            cropped["grid"]["crop_mm"][edge] = float(share) * min(size[one] for one in across)
        scene = _scene(cropped)
        if view(scene, build_rig(scene, "wanted scene")).share_scored >= _SCORED:
            return cropped
    raise InputError(
        f"--depth: expected one over which the cameras' views meet, got {wanted.depth_mm:g} mm"
    )
