"""Flow of Arnold, Beltrami and Childress."""

import numpy as np
from pydantic import Field

from sabench.api import F64, Flow, Parameters


class AbcParameters(Parameters):
    """Amplitudes and wavelength."""

    center_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="origin of the flow's coordinates"
    )
    wavelength_mm: float = Field(20.0, gt=0.0, description="period along each axis")
    a_mm_s: float = Field(100.0, description="amplitude A, of the waves along Z")
    b_mm_s: float = Field(81.6497, description="amplitude B, of the waves along X")
    c_mm_s: float = Field(57.735, description="amplitude C, of the waves along Y")


class AbcFlow(Flow):
    """ABC flow: a steady solution of Euler's equations with chaotic pathlines.

    It is free of divergence and parallel to its own vorticity.
    """

    name = "abc_flow"
    references = ("T. Dombre et al., J. Fluid Mech. 167, 353-391, 1986",)
    Parameters = AbcParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute the ABC flow.

        u = A sin kz + C cos ky, v = B sin kx + A cos kz, w = C sin ky + B cos kx.
        """
        a, b, c = self._amplitudes()
        x, y, z = self._phases(points_mm)
        return np.stack(
            [
                a * np.sin(z) + c * np.cos(y),
                b * np.sin(x) + a * np.cos(z),
                c * np.sin(y) + b * np.cos(x),
            ],
            axis=1,
        )

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute the derivatives of the velocity."""
        a, b, c = self._amplitudes()
        x, y, z = self._phases(points_mm)
        out = np.zeros((len(points_mm), 3, 3))
        out[:, 0, 1], out[:, 0, 2] = -c * np.sin(y), a * np.cos(z)
        out[:, 1, 0], out[:, 1, 2] = b * np.cos(x), -a * np.sin(z)
        out[:, 2, 0], out[:, 2, 1] = -b * np.sin(x), c * np.cos(y)
        return np.asarray(out * (2.0 * np.pi / self.parameters.wavelength_mm))

    def _amplitudes(self) -> tuple[float, float, float]:
        return self.parameters.a_mm_s, self.parameters.b_mm_s, self.parameters.c_mm_s

    def _phases(self, points_mm: F64) -> F64:
        return np.asarray(
            (
                2.0
                * np.pi
                / self.parameters.wavelength_mm
                * (points_mm - np.asarray(self.parameters.center_mm))
            ).T
        )
