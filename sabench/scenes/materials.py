"""Refractive indices of a scene's named materials, and the inertia of particles."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from sabench.geometry.dispersion import refractive_index
from sabench.utils.arrays import F64
from sabench.utils.validation import Positive, Table, Vector

_LASER_NM, _LAMP_NM = 532.0, 550.0  # defaults of the tables
_ANY = 1.5  # in place of an index that a fault leaves open
Faults = list[tuple[str, str]]


def fill_indices(values: dict[str, Any]) -> tuple[dict[str, Any], Faults]:
    """Add the index of every named material to a scene's tables.

    Returns the scene's values, and faults as pairs of a key and a sentence.
    """
    faults: Faults = []
    nm, filled = _wavelength_nm(values), dict(values)
    if isinstance(wall := values.get("wall"), list | tuple):
        filled["wall"] = [_wall(one, f"wall.{n}", nm, faults) for n, one in enumerate(wall)]
    elif "wall" in values:
        filled["wall"] = _wall(wall, "wall", nm, faults)
    light = values.get("illumination")
    entry = light.get("entry") if isinstance(light, dict) else None
    if isinstance(light, dict) and isinstance(entry, dict) and "layers" in entry:
        layers = _layers(entry["layers"], "illumination.entry.layers", nm, faults)
        filled["illumination"] = {**light, "entry": {**entry, "layers": layers}}
    return filled, faults


def _wavelength_nm(values: dict[str, Any]) -> float | None:
    """Give the laser's wavelength, or that of the lamps; None where it is no number."""
    for key in ("illumination", "backlight", "lighting"):
        if isinstance(table := values.get(key), dict):
            default = _LASER_NM if key == "illumination" else _LAMP_NM
            return _number(table.get("wavelength_nm", default))
    return _LAMP_NM


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _wall(wall: Any, path: str, nm: float | None, faults: Faults) -> Any:
    if not isinstance(wall, dict):
        return wall
    celsius, filled = wall.get("temperature_c"), dict(wall)
    if celsius is not None and wall.get("fluid") != "water":
        expected = 'expected fluid = "water" with it'
        faults.append((f"{path}.temperature_c", f"{expected}, got {wall.get('fluid')}"))
    else:
        celsius = 20.0 if celsius is None else celsius
        filled = dict(_filled(wall, "fluid", "fluid_index", path, nm, faults, celsius))
    for key in ("layers", "rear"):
        if key in filled:
            filled[key] = _layers(filled[key], f"{path}.{key}", nm, faults)
    return filled


def _layers(layers: Any, path: str, nm: float | None, faults: Faults) -> Any:
    if not isinstance(layers, list | tuple):
        return layers
    return [
        _filled(layer, "material", "index", f"{path}.{number}", nm, faults)
        for number, layer in enumerate(layers)
    ]


def _filled(
    table: Any,
    name_key: str,
    index_key: str,
    path: str,
    nm: float | None,
    faults: Faults,
    celsius: Any = 20.0,
) -> Any:
    """Add the index of a table's material; exactly one of both may be given."""
    if not isinstance(table, dict) or table.get(name_key) is None:
        return table
    name, index = table[name_key], _ANY
    if index_key in table:
        faults.append((f"{path}.{name_key}", f"expected it or {index_key}, got both"))
        return table
    if isinstance(name, str) and nm is not None and _number(celsius) is not None:
        try:
            index = refractive_index(name, nm, celsius)
        except ValueError as error:
            faults.append((f"{path}.{name_key}", str(error)))
    return {**table, index_key: index}


class Inertia(Table):
    """Densities of particles and fluid, its viscosity, and gravity."""

    particle_density_kg_m3: Positive = Field(
        description="density of the particles", examples=[1050.0]
    )
    fluid_density_kg_m3: Positive = Field(
        998.2, description="density of the fluid; by default of water at 20 C"
    )
    viscosity_mm2_s: Positive = Field(1.0, description="kinematic viscosity of the fluid")
    gravity_m_s2: Vector = Field(
        (0.0, 9.81, 0.0),
        description="acceleration by gravity, world frame; by default downwards in the images",
    )

    def response_s(self, diameter_mm: F64) -> F64:
        """Compute the time that turns an acceleration into a slip velocity.

        (rho_p / rho_f - 1) d^2 / (18 nu): times gravity, it is Stokes's settling velocity. Below
        0 for particles lighter than the fluid.
        """
        excess = self.particle_density_kg_m3 / self.fluid_density_kg_m3 - 1.0
        return np.asarray(excess * diameter_mm**2 / (18.0 * self.viscosity_mm2_s))

    def relaxation_s(self, diameter_mm: F64) -> F64:
        """Compute the particles' relaxation time with added mass.

        (2 rho_p / rho_f + 1) d^2 / (36 nu).
        """
        mass = 2.0 * self.particle_density_kg_m3 / self.fluid_density_kg_m3 + 1.0
        return np.asarray(mass * diameter_mm**2 / (36.0 * self.viscosity_mm2_s))
