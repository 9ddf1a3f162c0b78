"""Refractive indices of named materials, and the inertia of particles.

Indices are relative to air at 15 degrees Celsius. Cameras and lasers stand in air, whose index is 1
in a scene; glass catalogues state indices relative to air, too.
"""

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from sabench.utils.arrays import F64
from sabench.utils.validation import Positive, Table, Vector


@dataclass(frozen=True)
class Medium:
    """A material, with the range of its formula.

    Attributes
    ----------
    range_nm : wavelengths of the measurements behind the formula.
    index : function of the wavelength in micrometres and of the temperature in degrees Celsius.
    source : of the formula.
    """

    range_nm: tuple[float, float]
    index: Callable[[float, float], float]
    source: str


def refractive_index(name: str, wavelength_nm: float, celsius: float = 20.0) -> float:
    """Compute the refractive index of a named material.

    The temperature counts for water only.

    Raises ValueError: an unknown name, or a wavelength or temperature outside the formula's range.
    """
    medium = MEDIA.get(_ALIASES.get(name, name))
    if medium is None:
        lower = {known.lower(): known for known in (*MEDIA, *_ALIASES)}
        near = [lower[word] for word in difflib.get_close_matches(name.lower(), lower, 3, 0.4)]
        *first, last = near or lower.values()
        such = f"{', '.join(first)} or {last}" if first else last
        raise ValueError(f"expected a known material, such as {such}; got {name}")
    low, high = medium.range_nm
    if not low <= wavelength_nm <= high:
        raise ValueError(
            f"expected light of {low:g} to {high:g} nm, for which the index of {name} is known, "
            f"got {wavelength_nm:g} nm"
        )
    if name == "water" and not 0.0 <= celsius <= 100.0:
        raise ValueError(f"expected water of 0 to 100 degrees Celsius, got {celsius:g}")
    return medium.index(wavelength_nm * 1e-3, celsius)


def _sellmeier(*terms: tuple[float, float]) -> Callable[[float, float], float]:
    """Make n from n^2 - 1 = sum of B l^2 / (l^2 - C), C in square micrometres."""

    def index(micrometre: float, celsius: float) -> float:
        square = micrometre**2
        return math.sqrt(1.0 + sum(b * square / (square - c) for b, c in terms))

    return index


def _air(micrometre: float) -> float:
    """Compute the index of air in vacuum, at 15 degrees Celsius and 101325 Pa.

    Source: Ciddor, Appl. Opt. 35 (1996) 1566-1573, equation 1.
    """
    s = micrometre**-2
    return 1.0 + 0.05792105 / (238.0185 - s) + 0.00167917 / (57.362 - s)


def _density(celsius: float) -> float:
    """Compute the density of water at 101325 Pa, kg/m^3.

    Source: Kell, J. Chem. Eng. Data 20 (1975) 97-105, equation 16.
    """
    terms = (999.83952, 16.945176, -7.9870401e-3, -46.170461e-6, 105.56302e-9, -280.54253e-12)
    polynomial = sum(term * celsius**power for power, term in enumerate(terms))
    return polynomial / (1.0 + 16.87985e-3 * celsius)


def water_in_vacuum(micrometre: float, celsius: float, density: float) -> float:
    """Compute the index of water relative to vacuum.

    Source: IAPWS R9-97, equation 1 (Harvey, Gallagher and Levelt Sengers, J. Phys. Chem. Ref. Data
    27 (1998) 761-774).
    """
    d, t, square = density / 1000.0, (celsius + 273.15) / 273.15, (micrometre / 0.589) ** 2
    lorentz = d * (
        0.244257733
        + 9.74634476e-3 * d
        - 3.73234996e-3 * t
        + 2.68678472e-4 * square * t
        + 1.5892057e-3 / square
        + 2.45934259e-3 / (square - 0.229202**2)
        + 0.90070492 / (square - 5.432937**2)
        - 1.66626219e-2 * d**2
    )
    return math.sqrt((1.0 + 2.0 * lorentz) / (1.0 - lorentz))


MEDIA = {
    "air": Medium((230.0, 1690.0), lambda micrometre, celsius: 1.0, "by definition"),
    "water": Medium(
        (200.0, 1100.0),
        lambda um, celsius: water_in_vacuum(um, celsius, _density(celsius)) / _air(um),
        "IAPWS R9-97; Kell (1975)",
    ),
    "BK7": Medium(
        (300.0, 2500.0),
        _sellmeier(
            (1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653)
        ),
        "SCHOTT, data sheet of N-BK7",
    ),
    "fused silica": Medium(
        (210.0, 3710.0),
        _sellmeier((0.6961663, 0.0684043**2), (0.4079426, 0.1162414**2), (0.8974794, 9.896161**2)),
        "Malitson, J. Opt. Soc. Am. 55 (1965) 1205-1209",
    ),
    "acrylic": Medium(
        (437.0, 1052.0),
        _sellmeier((1.1819, 0.011313)),
        "Sultanova, Kasarova and Nikolov, Acta Phys. Pol. A 116 (2009) 585-587",
    ),
    "soda-lime glass": Medium(
        (310.0, 4600.0),
        lambda micrometre, celsius: 1.513 - 0.003169 * micrometre**2 + 0.003962 / micrometre**2,
        "Rubin, Sol. Energy Mater. 12 (1985) 275-288, clear glass",
    ),
}
_ALIASES = {"N-BK7": "BK7", "PMMA": "acrylic"}


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
