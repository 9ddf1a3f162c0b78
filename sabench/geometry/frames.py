"""Frames of reference.

They are the box of a volume, and poses of bodies in the world frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64


@dataclass(frozen=True)
class Domain:
    """Box that a generator fills, along the world's axes.

    Attributes
    ----------
    center_mm, size_mm : centre and edges of the box in the world frame.
    pixels : pixels of one camera's image, for densities per pixel.
    """

    center_mm: tuple[float, float, float]
    size_mm: tuple[float, float, float]
    pixels: int

    @property
    def low_mm(self) -> F64:
        """Corner (3,) with the smallest coordinates."""
        return np.asarray(self.center_mm) - np.asarray(self.size_mm) / 2.0

    @property
    def volume_mm3(self) -> float:
        """Volume of the box."""
        return float(np.prod(self.size_mm))


@dataclass(frozen=True)
class Pose:
    """Rotation and position of a target: the map x -> rotation x + position_mm.

    Attributes
    ----------
    rotation : (3, 3) from the target's frame to the world's.
    position_mm : (3,) the target's own origin in the world frame.
    """

    rotation: F64
    position_mm: F64

    def __call__(self, points_mm: F64) -> F64:
        """Compute world points (n, 3) of points in the target's frame."""
        return np.asarray(points_mm @ self.rotation.T + self.position_mm)
