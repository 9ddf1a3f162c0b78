"""Sinusoidal shear."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from sabench.api import F64, Flow, Parameters


class ShearWaveParameters(Parameters):
    """Direction, amplitude and wavelength of the wave."""

    center_mm: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.0), description="point at which the velocity is zero"
    )
    along: tuple[float, float, float] = Field(
        (1.0, 0.0, 0.0), description="direction of the velocity"
    )
    across: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0), description="direction in which it varies"
    )
    wavelength_mm: float = Field(10.0, gt=0.0, description="wavelength of the velocity")
    peak_mm_s: float = Field(100.0, description="largest velocity")

    @model_validator(mode="after")
    def _square(self) -> ShearWaveParameters:
        if abs(np.dot(self.along, self.across)) > 1e-9 * np.linalg.norm(
            self.along
        ) * np.linalg.norm(self.across):
            raise ValueError(
                f"expected along and across at right angles, got {list(self.along)} and "
                f"{list(self.across)}"
            )
        return self


class ShearWave(Flow):
    """Velocity that varies as a sine across its own direction.

    The amplitude that a method finds shows how well it resolves the wavelength.
    """

    name = "shear_wave"
    Parameters = ShearWaveParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute A sin(k y) along x."""
        along, _, phase = self._wave(points_mm)
        return np.asarray(self.parameters.peak_mm_s * np.sin(phase)[:, None] * along)

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Compute A k cos(k y)."""
        along, across, phase = self._wave(points_mm)
        slope = (
            self.parameters.peak_mm_s * 2.0 * np.pi / self.parameters.wavelength_mm * np.cos(phase)
        )
        return np.asarray(slope[:, None, None] * np.outer(along, across))

    def _wave(self, points_mm: F64) -> tuple[F64, F64, F64]:
        along, across = (
            np.asarray(v) / np.linalg.norm(v)
            for v in (self.parameters.along, self.parameters.across)
        )
        phase = (
            2.0
            * np.pi
            / self.parameters.wavelength_mm
            * ((points_mm - np.asarray(self.parameters.center_mm)) @ across)
        )
        return along, across, phase
