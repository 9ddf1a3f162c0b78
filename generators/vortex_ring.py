"""A vortex ring."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from sabench.api import Flow, Parameters
from sabench.arrays import F64
from sabench.optics.rotation import leading

_AXIS = 1e-9  # mm: nearer to the ring's axis there is no direction away from it


class VortexRingParameters(Parameters):
    """The ring and how fast it turns."""

    center_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = Field((0.0, 0.0, 1.0), description="through the ring's middle, the way it moves the fluid there")
    diameter_mm: float = Field(20.0, gt=0.0, description="of the toroidal axis")
    core_mm: float = Field(4.0, gt=0.0, description="distance from the toroidal axis at which the fluid is fastest, l")
    peak_mm_s: float = Field(100.0, description="speed there, 8 K / e")


class VortexRing(Flow):
    """The thesis's ring: the fluid turns about a circle, at a speed that depends on the distance from it only.

    Such a field is not free of divergence, and has a fold along the ring's axis, where it still has a component away from it.
    """

    name = "vortex_ring"
    references = ("J. Belden, PhD thesis, MIT 2011, equation 2.14",)
    Parameters = VortexRingParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """|V| = (8 K R / l) exp(-R / l), R from the circle."""
        r, z, outward = self._cylindrical(points_mm)
        away = r - self.parameters.diameter_mm / 2.0
        rate = self._rate(np.hypot(away, z))
        turn = leading(self.parameters.axis)
        return np.asarray((rate * z)[:, None] * outward - (rate * away)[:, None] * turn[2])

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """By the chain rule in cylindrical coordinates."""
        r, z, outward = self._cylindrical(points_mm)
        away, axis = r - self.parameters.diameter_mm / 2.0, leading(self.parameters.axis)[2]
        distance = np.maximum(np.hypot(away, z), 1e-300)
        rate = self._rate(distance)
        slope = -rate / self.parameters.core_mm / distance  # of the rate, over the distance
        along = np.broadcast_to(axis, outward.shape)
        around = np.cross(along, outward)
        parts = (
            (slope * away * z, outward, outward), (rate + slope * z * z, outward, along),
            (-rate - slope * away * away, along, outward), (-slope * away * z, along, along), (rate * z / np.maximum(r, _AXIS), around, around),
        )  # fmt: skip
        return np.asarray(sum(np.einsum("n,ni,nj->nij", value, i, j) for value, i, j in parts))

    def _cylindrical(self, points_mm: F64) -> tuple[F64, F64, F64]:
        """Distance from the ring's axis, height along it, and unit vectors (n, 3) away from it."""
        offset, axis = points_mm - np.asarray(self.parameters.center_mm), leading(self.parameters.axis)[2]
        z = offset @ axis
        lateral = offset - z[:, None] * axis
        r = np.linalg.norm(lateral, axis=1)
        return r, z, lateral / np.maximum(r, _AXIS)[:, None]

    def _rate(self, distance: F64) -> F64:
        """Speed over the distance from the circle."""
        chosen: VortexRingParameters = self.parameters
        return np.asarray(chosen.peak_mm_s * np.e / chosen.core_mm * np.exp(-distance / chosen.core_mm))
