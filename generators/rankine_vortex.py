"""Rankine's vortex."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters
from sabench.worlds.library.vortices import lateral, turning, turning_gradient


class RankineParameters(Parameters):
    """Position, direction and strength of the vortex."""

    center_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="point on the vortex's axis"
    )
    axis: tuple[float, float, float] = Field(
        (0.0, 0.0, 1.0), description="direction of the vortex's axis"
    )
    core_mm: float = Field(
        4.0, gt=0.0, description="radius inside which the fluid turns like a solid"
    )
    peak_mm_s: float = Field(100.0, description="speed at the edge of the core")


class RankineVortex(Flow):
    """Rankine's vortex: a core in solid-body rotation in irrotational fluid.

    The gradient jumps at the core's edge.
    """

    name = "rankine_vortex"
    references = ("W. J. M. Rankine, A Manual of Applied Mechanics, 1858",)
    Parameters = RankineParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute the speed: r / r_c of the peak inside the core, r_c / r outside."""
        offset, distance, along = self._lateral(points_mm)
        return turning(offset, along, self._rate(distance))

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives of the velocity, on either side of the edge."""
        offset, distance, along = self._lateral(points_mm)
        rate = self._rate(distance)
        outside = distance > self.parameters.core_mm
        return turning_gradient(
            offset,
            along,
            rate,
            np.where(
                outside, -2.0 * rate / np.maximum(distance, self.parameters.core_mm) ** 2, 0.0
            ),
        )

    def _lateral(self, points_mm: F64) -> tuple[F64, F64, F64]:
        return lateral(points_mm, self.parameters.center_mm, self.parameters.axis)

    def _rate(self, distance: F64) -> F64:
        chosen: RankineParameters = self.parameters
        return np.asarray(
            chosen.peak_mm_s * chosen.core_mm / np.maximum(distance, chosen.core_mm) ** 2
        )
