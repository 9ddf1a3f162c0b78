"""Vortex of Lamb and Oseen."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters
from sabench.worlds.library.vortices import lateral, turning, turning_gradient

_SMALL = 1e-4  # of the core squared: below, the series is exact to rounding


class LambOseenParameters(Parameters):
    """Strength, position and spreading of the vortex."""

    center_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="point on the vortex's axis"
    )
    axis: tuple[float, float, float] = Field(
        (0.0, 0.0, 1.0), description="direction of the vortex's axis"
    )
    core_mm: float = Field(
        4.0, gt=0.0, description="core radius r_c of 1 - exp(-r^2 / r_c^2), at the start"
    )
    circulation_mm2_s: float = Field(4000.0, description="circulation far from the axis")
    viscosity_mm2_s: float = Field(
        0.0,
        ge=0.0,
        description="kinematic viscosity, 1 for water: r_c^2 grows by 4 times that per second",
    )


class LambOseenVortex(Flow):
    """Lamb-Oseen vortex: a Gaussian core, which viscosity spreads.

    It is a solution of the Navier-Stokes equations.
    """

    name = "lamb_oseen_vortex"
    references = (
        "C. W. Oseen, Ark. Mat. Astron. Fys. 7, 14, 1912",
        "H. Lamb, Hydrodynamics, 1932, section 334a",
    )
    Parameters = LambOseenParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute the speed Gamma / (2 pi r) (1 - exp(-r^2 / r_c^2)) around the axis."""
        offset, distance, along = lateral(
            points_mm, self.parameters.center_mm, self.parameters.axis
        )
        return turning(offset, along, self._rates(distance, time_s)[0])

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives of the velocity."""
        offset, distance, along = lateral(
            points_mm, self.parameters.center_mm, self.parameters.axis
        )
        return turning_gradient(offset, along, *self._rates(distance, time_s))

    def _rates(self, distance: F64, time_s: float) -> tuple[F64, F64]:
        """Compute the angular velocity, and its derivative by r over r.

        With q = r^2 / r_c^2 they are (1 - e^-q) / q and its slope.
        """
        chosen: LambOseenParameters = self.parameters
        core = chosen.core_mm**2 + 4.0 * chosen.viscosity_mm2_s * time_s
        q = distance**2 / core
        safe = np.maximum(q, _SMALL)
        share = np.where(q > _SMALL, -np.expm1(-safe) / safe, 1.0 - q / 2.0 + q * q / 6.0)
        slope = np.where(q > _SMALL, (np.exp(-safe) * (1.0 + safe) - 1.0) / safe**2, -0.5 + q / 3.0)
        scale = chosen.circulation_mm2_s / (2.0 * np.pi * core)
        return scale * share, scale * slope * 2.0 / core
