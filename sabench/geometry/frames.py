"""Frames of reference: the box of a volume, and poses of bodies in the world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Domain:
    """What a generator fills.

    Attributes
    ----------
    center_mm, size_mm : the seeded box in the world frame, axis-aligned.
    pixels : pixels of one camera's image, for densities per pixel.
    """

    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    pixels: int

    @property
    def low_mm(self) -> F64:
        """The corner with the smallest coordinates."""
        return np.asarray(self.center_mm) - np.asarray(self.size_mm) / 2.0

    @property
    def volume_mm3(self) -> float:
        """Volume of the box."""
        return float(np.prod(self.size_mm))


@dataclass(frozen=True)
class Pose:
    """Where a target stands: its points are turn x + place_mm in the world frame; turn (3, 3), place_mm (3,)."""

    turn: F64
    place_mm: F64

    def __call__(self, points_mm: F64) -> F64:
        """World points (n, 3) of the target's."""
        return np.asarray(points_mm @ self.turn.T + self.place_mm)
