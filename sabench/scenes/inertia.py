"""Table of a scene for particles that do not follow the fluid exactly."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from sabench.utils.arrays import F64
from sabench.utils.fields import Positive, Table, Vector


class Inertia(Table):
    """Densities of particles and fluid, its viscosity, and gravity."""

    particle_density_kg_m3: Positive = Field(
        description="density of the particles", examples=[1050.0]
    )
    fluid_density_kg_m3: Positive = Field(
        998.2, description="density of the fluid; by default of water at 20 C"
    )
    viscosity_mm2_s: Positive = Field(1.0, description="kinematic viscosity of the fluid")
    gravity_m_s2: Vector = Field(
        (0.0, 9.81, 0.0),
        description="acceleration by gravity, world frame; by default downwards in the images",
    )

    def response_s(self, diameter_mm: F64) -> F64:
        """Compute the time that turns an acceleration into a slip velocity.

        (rho_p / rho_f - 1) d^2 / (18 nu): times gravity, it is Stokes's settling velocity. Below
        0 for particles lighter than the fluid.
        """
        excess = self.particle_density_kg_m3 / self.fluid_density_kg_m3 - 1.0
        return np.asarray(excess * diameter_mm**2 / (18.0 * self.viscosity_mm2_s))

    def relaxation_s(self, diameter_mm: F64) -> F64:
        """Compute the particles' relaxation time with added mass.

        (2 rho_p / rho_f + 1) d^2 / (36 nu).
        """
        mass = 2.0 * self.particle_density_kg_m3 / self.fluid_density_kg_m3 + 1.0
        return np.asarray(mass * diameter_mm**2 / (36.0 * self.viscosity_mm2_s))
