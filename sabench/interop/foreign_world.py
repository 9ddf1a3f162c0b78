"""Worlds of other programs: another origin, other axes and other units than ours."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.utils.arrays import F64, Rows, triple
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, read_json

WORLD_FILE = "sabench-world.json"
LENGTHS_MM = {"m": 1e3, "dm": 1e2, "cm": 10.0, "mm": 1.0, "um": 1e-3, "in": 25.4}
_UNIT_AXES: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class ForeignFormatWarning(UserWarning):
    """Loss in a foreign format, or a change that was needed to read it."""


def note(sentence: str) -> None:
    """Warn of a loss or a change."""
    warnings.warn(ForeignFormatWarning(sentence), stacklevel=2)


def unit_mm(unit: str) -> float:
    """Return a unit of length in mm.

    Raises
    ------
    InputError
        A unit that is not known.
    """
    if unit not in LENGTHS_MM:
        raise InputError(f"unit: expected one of {', '.join(LENGTHS_MM)}, got {unit!r}")
    return LENGTHS_MM[unit]


@dataclass(frozen=True)
class ForeignWorld:
    """World of another program in ours.

    Attributes
    ----------
    origin_mm : its origin.
    axes : its X, Y and Z axes as rows, a right-handed rotation.
    """

    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: Rows = _UNIT_AXES

    def into(self, points_mm: F64) -> F64:
        """Transform points (n, 3) of our world to the other."""
        return np.asarray((points_mm - np.asarray(self.origin_mm)) @ np.asarray(self.axes).T)

    def back(self, points_mm: F64) -> F64:
        """Transform points (n, 3) of the other world to ours."""
        return np.asarray(points_mm @ np.asarray(self.axes) + np.asarray(self.origin_mm))

    def write(self, folder: Path) -> None:
        """Write the file by which results come back into our world."""
        record = {"origin_mm": self.origin_mm, "axes": self.axes}
        (folder / WORLD_FILE).write_text(canonical_json(record), encoding="utf-8")


def read_world(path: Path) -> ForeignWorld:
    """Read the world of a folder or of one of the two above it; by default ours."""
    for folder in (path, *path.parents[:2]):
        file = folder / WORLD_FILE
        if file.is_file():
            return _parse(file)
    return ForeignWorld()


def _parse(file: Path) -> ForeignWorld:
    record = read_json(file)
    try:
        origin, axes = np.array(record["origin_mm"], float), np.array(record["axes"], float)
        sound = origin.shape == (3,) and np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    except (KeyError, TypeError, ValueError):
        sound = False
    if not sound:
        raise InputError(f"{file}: expected origin_mm and orthonormal axes, got {record!r}")
    return ForeignWorld(triple(origin), tuple(triple(row) for row in axes))
