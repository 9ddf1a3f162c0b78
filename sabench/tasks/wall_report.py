"""Unknowns of a wall in a calibration's report, and what the data show of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.calibration.joint_fit import nominal_sigmas
from sabench.algorithms.calibration.parameters import WALL, FreeParameters, State
from sabench.geometry.refraction import Wall
from sabench.geometry.rotations import frame_of_normal
from sabench.utils.arrays import F64

_SHOWN = 0.5  # part of a nominal value's standard deviation that what data show stays below


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
    shown : whether the data say clearly more than the nominal value.
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
    nominal: Wall, found: Wall, state: State, free: FreeParameters, shared_std: F64
) -> tuple[WallUnknown, ...]:
    """List the free unknowns of a wall.

    Parameters
    ----------
    state : of the calibration, in the frame of the wall.
    shared_std : (s,) bound of what all cameras share, see `cramer_rao.Limit`.
    """
    names = [
        *((f"index of {name}", "") for name in media_of(nominal)),
        *((f"thickness of {layer.name}", "mm") for layer in nominal.layers),
        ("tilt of the wall about X", "deg"),
        ("tilt of the wall about Y", "deg"),
        ("place of the wall", "mm"),
    ]
    scales = np.ones(len(names))
    scales[-WALL:-1] = math.degrees(1.0)
    before, after = (_values(wall, nominal).tolist() for wall in (nominal, found))
    sigmas = nominal_sigmas(state)
    _, shared = free.columns(len(state.indices))
    rows = []
    for number, std in zip(shared.tolist(), shared_std.tolist(), strict=True):
        if number < len(names):
            own = std * float(scales[number]) if math.isfinite(std) else None
            shown = std < _SHOWN * float(sigmas[number])
            rows.append(WallUnknown(*names[number], before[number], after[number], own, shown))
    return tuple(rows)


def _values(wall: Wall, nominal: Wall) -> F64:
    """List indices, thicknesses, tilts (deg) and place (mm) of a wall against the nominal one."""
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
        yield (
            f"The data do not show the {listed}; the fit stays near what is nominal: measure what "
            "is listed, and take it out of the unknowns."
        )


def _standard_deviation(one: WallUnknown) -> str:
    unit = f" {one.unit}" if one.unit else ""
    std = "infinite" if one.std is None else f"{one.std:.3g}{unit}"
    return f"{one.name} (standard deviation {std})"
