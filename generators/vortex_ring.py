"""Vortex ring."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters, frame_along

_AXIS = 1e-9  # mm: nearer to the ring's axis there is no direction away from it


class VortexRingParameters(Parameters):
    """Position, size and speed of the ring."""

    center_mm: tuple[float, float, float] = Field((0.0, 0.0, 0.0), description="centre of the ring")
    axis: tuple[float, float, float] = Field(
        (0.0, 0.0, 1.0), description="direction in which the ring moves the fluid at its centre"
    )
    diameter_mm: float = Field(20.0, gt=0.0, description="diameter of the toroidal axis")
    core_mm: float = Field(
        4.0, gt=0.0, description="distance l from the toroidal axis at which the fluid is fastest"
    )
    peak_mm_s: float = Field(100.0, description="speed at the distance `core_mm`, 8 K / e")
    fold_mm: float = Field(
        0.5,
        gt=0.0,
        description="distance from the ring's axis within which the component away from it is "
        "let go to zero",
    )


class VortexRing(Flow):
    """Vortex ring of the thesis.

    The fluid rotates about a circle, at a speed that depends on the distance from it only.

    Such a field is not free of divergence. On the ring's axis it would have a fold, where fluid
    from all sides would meet and stay; the field is smoothed there, and only there.
    """

    name = "vortex_ring"
    references = ("J. Belden, PhD thesis, MIT 2011, equation 2.14",)
    Parameters = VortexRingParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute |V| = (8 K R / l) exp(-R / l), with R from the circle."""
        r, z, outward = self._cylindrical(points_mm)
        away = r - self.parameters.diameter_mm / 2.0
        rate = self._rate(np.hypot(away, z))
        axes = frame_along(self.parameters.axis)
        return np.asarray(
            (rate * z * r * self._fade_near_axis(r)[0])[:, None] * outward
            - (rate * away)[:, None] * axes[2]
        )

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives by the chain rule in cylindrical coordinates."""
        r, z, outward = self._cylindrical(points_mm)
        away, axis = r - self.parameters.diameter_mm / 2.0, frame_along(self.parameters.axis)[2]
        distance = np.maximum(np.hypot(away, z), 1e-300)
        rate = self._rate(distance)
        slope = -rate / self.parameters.core_mm / distance  # of the rate, over the distance
        along = np.broadcast_to(axis, outward.shape)
        around = np.cross(along, outward)
        share, growth = self._fade_near_axis(r)
        parts = (
            (slope * away * z * r * share + rate * z * growth, outward, outward),
            ((rate + slope * z * z) * r * share, outward, along),
            (-rate - slope * away * away, along, outward),
            (-slope * away * z, along, along),
            (rate * z * share, around, around),
        )
        return np.asarray(sum(np.einsum("n,ni,nj->nij", value, i, j) for value, i, j in parts))

    def _cylindrical(self, points_mm: F64) -> tuple[F64, F64, F64]:
        """Compute cylindrical coordinates about the ring's axis.

        Distance from the axis, height along it, and unit vectors (n, 3) away from it.
        """
        offset = points_mm - np.asarray(self.parameters.center_mm)
        axis = frame_along(self.parameters.axis)[2]
        z = offset @ axis
        lateral = offset - z[:, None] * axis
        r = np.linalg.norm(lateral, axis=1)
        return r, z, lateral / np.maximum(r, _AXIS)[:, None]

    def _fade_near_axis(self, r: F64) -> tuple[F64, F64]:
        """Fade out the outward component near the axis.

        Returns the part that is left over the distance from the axis, and its derivative.
        """
        fold = self.parameters.fold_mm
        t = np.minimum(r / fold, 1.0)
        share = np.where(
            t < 1.0, (15.0 - 10.0 * t**2 + 3.0 * t**4) / (8.0 * fold), 1.0 / np.maximum(r, fold)
        )
        return share, 15.0 / 8.0 * (1.0 - t**2) ** 2 / fold

    def _rate(self, distance: F64) -> F64:
        """Compute the speed over the distance from the circle."""
        chosen: VortexRingParameters = self.parameters
        return np.asarray(
            chosen.peak_mm_s * np.e / chosen.core_mm * np.exp(-distance / chosen.core_mm)
        )
