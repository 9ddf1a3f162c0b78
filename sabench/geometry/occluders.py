"""Opaque discs on the cameras' side of the wall, where light still runs straight."""

import math
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64, Bool

_RINGS, _AROUND = 33, 360  # points of a disc where it is sampled


@dataclass(frozen=True)
class Disc:
    """Thin, opaque, black disc in the cameras' medium.

    Attributes
    ----------
    center_mm : world frame.
    normal : unit vector perpendicular to the disc; its sign does not matter.
    radius_mm : to the edge, which belongs to the disc.
    """

    center_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    radius_mm: float

    def span_mm(self, along: F64) -> tuple[float, float]:
        """Find the extent of the disc's points along a unit vector (3,).

        Returns their smallest and largest coordinate.
        """
        middle, tilt = float(np.dot(self.center_mm, along)), float(np.dot(self.normal, along))
        half = self.radius_mm * math.sqrt(max(0.0, 1.0 - tilt * tilt))
        return middle - half, middle + half

    def points_mm(self) -> F64:
        """Compute points (n, 3) all over the disc, the edge included."""
        normal = np.asarray(self.normal)
        first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        first /= np.linalg.norm(first)
        radius, angle = np.meshgrid(
            np.linspace(0.0, self.radius_mm, _RINGS), np.arange(_AROUND) * 2.0 * np.pi / _AROUND
        )
        right, up = (radius * np.cos(angle)).reshape(-1, 1), (radius * np.sin(angle)).reshape(-1, 1)
        return np.asarray(self.center_mm + right * first + up * np.cross(normal, first))

    def stops(self, pinhole_mm: F64, directions: F64) -> Bool:
        """Mark rays from a pinhole (3,) along directions (n, 3) that meet the disc.

        Rays along its plane pass, since it is thin.
        """
        offset, normal = np.asarray(self.center_mm) - pinhole_mm, np.asarray(self.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (offset @ normal) / (directions @ normal)
            miss = np.linalg.norm(distance[:, None] * directions - offset, axis=1)
            return np.asarray((distance > 0.0) & (miss <= self.radius_mm))
