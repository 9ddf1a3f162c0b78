"""Unknowns of a wall in a calibration's report, and what the data show of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.calibration.parameters import WALL, FreeParameters
from sabench.geometry.refraction import Wall
from sabench.geometry.rotations import frame_of_normal
from sabench.utils.arrays import F64

# errors of what a data sheet, a ruler and a spirit level show, without any calibration
_INDEX, _THICKNESS_MM, _TILT_DEG, _PLACE_MM = 0.01, 0.5, 0.5, 1.0


@dataclass(frozen=True)
class WallUnknown:
    """Unknown of the wall.

    Attributes
    ----------
    name, unit : such as "thickness of glass" and "mm".
    nominal, found : values; tilts and the place count from the nominal wall, the place along its
        normal through the world's origin.
    std : smallest standard deviation that the data allow without the nominal value (Cramer-Rao
        bound); None where nothing shows it.
    shown : whether they say more than a data sheet, a ruler and a spirit level.
    """

    name: str
    unit: str
    nominal: float
    found: float
    std: float | None
    shown: bool


def media_of(wall: Wall) -> tuple[str, ...]:
    """Name the media along the way of light from a camera."""
    return "the cameras' medium", *(layer.name for layer in wall.layers), "the fluid"


def wall_unknowns(
    nominal: Wall, found: Wall, free: FreeParameters, shared_std: F64
) -> tuple[WallUnknown, ...]:
    """List the free unknowns of a wall.

    Parameters
    ----------
    shared_std : (s,) bound of what all cameras share, see `cramer_rao.Limit`.
    """
    names = [
        *((f"index of {name}", "", _INDEX) for name in media_of(nominal)),
        *((f"thickness of {layer.name}", "mm", _THICKNESS_MM) for layer in nominal.layers),
        ("tilt of the wall about X", "deg", _TILT_DEG),
        ("tilt of the wall about Y", "deg", _TILT_DEG),
        ("place of the wall", "mm", _PLACE_MM),
    ]
    scales = np.ones(len(names))
    scales[-WALL:-1] = math.degrees(1.0)
    before, after = (_values(wall, nominal).tolist() for wall in (nominal, found))
    _, shared = free.columns(len(nominal.indices))
    rows = []
    for number, std in zip(shared.tolist(), shared_std.tolist(), strict=True):
        if number < len(names):
            name, unit, measured = names[number]
            own = std * float(scales[number])
            known = own if math.isfinite(own) else None
            figures = before[number], after[number], known
            rows.append(WallUnknown(name, unit, *figures, own < measured))
    return tuple(rows)


def _values(wall: Wall, nominal: Wall) -> F64:
    """List indices, thicknesses, tilts (deg) and place (mm) of a wall.

    Tilts and place count from the nominal wall.
    """
    axes = frame_of_normal(np.asarray(nominal.normal))
    right, down, along = axes @ np.asarray(wall.normal)
    place = np.asarray(wall.point_mm) @ np.asarray(wall.normal) / along
    tilts = np.rad2deg([-down, right])
    base = np.asarray(nominal.point_mm) @ axes[2]
    thick = [layer.thickness_mm for layer in wall.layers]
    return np.concatenate([wall.indices, thick, tilts, [place - base]])


def warn_of_unknowns(unknowns: Sequence[WallUnknown]) -> Iterator[str]:
    """Say in one sentence what the data do not show of the wall."""
    hidden = [one for one in unknowns if not one.shown]
    if hidden:
        listed = " and ".join(_standard_deviation(one) for one in hidden)
        yield f"The data hardly show the {listed}: measure it, and take it out of the unknowns."


def _standard_deviation(one: WallUnknown) -> str:
    unit = f" {one.unit}" if one.unit else ""
    std = "infinite" if one.std is None else f"{one.std:.3g}{unit}"
    return f"{one.name} (standard deviation {std})"
