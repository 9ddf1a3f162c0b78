"""Taylor-Green vortices."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters


class TaylorGreenParameters(Parameters):
    """Size, speed and decay of the cells."""

    center_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="corner where eight cells meet"
    )
    wavelength_mm: float = Field(20.0, gt=0.0, description="length of two cells")
    peak_mm_s: float = Field(100.0, description="largest speed, at the start")
    deep: bool = Field(
        True,
        description="cells along Z as well, with the start of Taylor and Green's own flow; else "
        "columns, which solve Navier-Stokes",
    )
    viscosity_mm2_s: float = Field(
        0.0, ge=0.0, description="kinematic viscosity, by which columns decay: 1 for water"
    )


class TaylorGreen(Flow):
    """Counter-rotating vortices in cells, free of divergence.

    Columns along Z are a solution of the Navier-Stokes equations.
    """

    name = "taylor_green"
    references = ("G. I. Taylor and A. E. Green, Proc. R. Soc. Lond. A 158, 499-521, 1937",)
    Parameters = TaylorGreenParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute the vortices.

        u = A cos(kx) sin(ky) cos(kz), v = -A sin(kx) cos(ky) cos(kz), w = 0.
        """
        (sx, cx), (sy, cy), (_, cz) = self._waves(points_mm)
        speed = self._speed(time_s)
        return np.stack(
            [speed * cx * sy * cz, -speed * sx * cy * cz, np.zeros(len(points_mm))], axis=1
        )

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives of the velocity."""
        (sx, cx), (sy, cy), (sz, cz) = self._waves(points_mm)
        slope = self._speed(time_s) * 2.0 * np.pi / self.parameters.wavelength_mm
        out = np.zeros((len(points_mm), 3, 3))
        out[:, 0] = slope * np.stack([-sx * sy * cz, cx * cy * cz, -cx * sy * sz], axis=1)
        out[:, 1] = slope * np.stack([-cx * cy * cz, sx * sy * cz, sx * cy * sz], axis=1)
        return out

    def _speed(self, time_s: float) -> float:
        chosen: TaylorGreenParameters = self.parameters
        wave = 2.0 * np.pi / chosen.wavelength_mm
        return chosen.peak_mm_s * float(np.exp(-2.0 * chosen.viscosity_mm2_s * wave**2 * time_s))

    def _waves(self, points_mm: F64) -> list[tuple[F64, F64]]:
        """Compute sine and cosine along each axis; 0 and 1 along Z for columns."""
        phases = (
            2.0
            * np.pi
            / self.parameters.wavelength_mm
            * (points_mm - np.asarray(self.parameters.center_mm))
        )
        if not self.parameters.deep:
            phases[:, 2] = 0.0
        return [(np.sin(phase), np.cos(phase)) for phase in phases.T]
