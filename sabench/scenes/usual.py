"""Values that no rig has: metres or micrometres where a key says millimetres."""

import math
from typing import Any

from sabench.scenes.scene import Scene

# least and most: sensors, lenses, lasers and tracers on sale; twice the densest case of the suites
_USUAL = {
    "cameras.pixel_mm": (0.0005, 0.1),
    "cameras.focal_length_mm": (1.0, 3000.0),
    "cameras.layout.spacing_mm": (1.0, 10_000.0),
    "cameras.layout.radius_mm": (1.0, 10_000.0),
    "volume.size_mm": (0.01, 10_000.0),
    "wall.layers.thickness_mm": (0.01, 1000.0),
    "illumination.wavelength_nm": (150.0, 2500.0),
    "lighting.wavelength_nm": (150.0, 2500.0),
    "backlight.wavelength_nm": (150.0, 2500.0),
    "particles.diameter_mm": (0.0001, 1.0),
    "particles.per_pixel": (0.0, 0.5),
}
_UNITS = {"mm": {"metres": 1e3, "micrometres": 1e-3, "nanometres": 1e-6}}
_UNITS["nm"] = {"micrometres": 1e3, "millimetres": 1e6, "metres": 1e9}


def unusual_values(scene: Scene) -> list[tuple[str, str]]:
    """List keys whose values no rig has, with a sentence and the unit that would fit."""
    found: dict[str, str] = {}
    for key, value in _numbers("", scene.to_dict()):
        least, most = _USUAL.get(key.replace("cameras.each.", "cameras."), (-math.inf, math.inf))
        if not least <= value <= most:
            found.setdefault(key, _sentence(key, value, least, most))
    return list(found.items())


def _numbers(key: str, value: Any) -> list[tuple[str, float]]:
    """List the numbers of a table by key, without places in lists."""
    if isinstance(value, dict):
        pairs = [(f"{key}.{name}".removeprefix("."), one) for name, one in value.items()]
        return [pair for name, one in pairs for pair in _numbers(name, one)]
    if isinstance(value, list | tuple):
        return [pair for one in value for pair in _numbers(key, one)]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return [(key, float(value))] if number else []


def _sentence(key: str, value: float, least: float, most: float) -> str:
    name = key.rpartition("_")[2]
    unit = f" {name}" if name in _UNITS else ""
    said = f"expected {least:g} to {most:g}{unit}, as rigs have, got {value:g}{unit}"
    for other, factor in _UNITS.get(name, {}).items():
        if least <= value * factor <= most:
            return f"{said}: is this in {other}? Then write {value * factor:g}"
    return said
