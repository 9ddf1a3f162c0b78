"""Homogeneous turbulence from random Fourier modes."""

from __future__ import annotations

import functools

import numpy as np
from pydantic import Field, model_validator

from sabench.api import F64, Flow, Parameters, stream


class TurbulenceParameters(Parameters):
    """Spectrum, and number of modes that represent it."""

    rms_mm_s: float = Field(50.0, gt=0.0, description="root mean square of each component")
    integral_mm: float = Field(
        20.0, gt=0.0, description="length at which the spectrum peaks, 2 pi / k"
    )
    kolmogorov_mm: float = Field(
        1.0, gt=0.0, description="length beyond which it falls exponentially"
    )
    modes: int = Field(200, ge=10, le=5000)
    draw: int = Field(1, ge=0, description="which field of all that have this spectrum")

    @model_validator(mode="after")
    def _check_order(self) -> TurbulenceParameters:
        if self.kolmogorov_mm >= self.integral_mm:
            raise ValueError(
                f"expected kolmogorov_mm below integral_mm, got {self.kolmogorov_mm:g} and "
                f"{self.integral_mm:g}"
            )
        return self


class Turbulence(Flow):
    """Random Fourier modes without divergence.

    Their spectrum is that of von Karman and Pao: k^4 at large lengths, k^(-5/3) at medium ones,
    and a cut-off at small ones.
    """

    name = "turbulence"
    references = (
        "R. H. Kraichnan, Phys. Fluids 13, 22-31, 1970",
        "Y. H. Pao, Phys. Fluids 8, 1063-1075, 1965",
    )
    Parameters = TurbulenceParameters

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Sum a cos(k x) + b sin(k x) over modes, frozen in time."""
        waves, a, b = self._modes
        out = np.zeros((len(points_mm), 3))
        for first in range(0, len(points_mm), 4096):  # the phases of one part stay in the cache
            phase = points_mm[first : first + 4096] @ waves.T
            out[first : first + 4096] = np.cos(phase) @ a + np.sin(phase) @ b
        return out

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Sum the derivatives of the modes."""
        waves, a, b = self._modes
        phase = points_mm @ waves.T
        return np.asarray(
            np.einsum("nm,mi,mj->nij", np.cos(phase), b, waves)
            - np.einsum("nm,mi,mj->nij", np.sin(phase), a, waves)
        )

    @functools.cached_property
    def _modes(self) -> tuple[F64, F64, F64]:
        """Wave vectors (m, 3) and amplitudes (m, 3), each perpendicular to its wave."""
        chosen: TurbulenceParameters = self.parameters
        rng, peak, cut = (
            stream(chosen.draw, "turbulence"),
            2.0 * np.pi / chosen.integral_mm,
            2.0 * np.pi / chosen.kolmogorov_mm,
        )
        edges = np.geomspace(0.1 * peak, 3.0 * cut, chosen.modes + 1)
        length, width = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)
        ratio = length / peak
        energy = (
            ratio**4
            / (1.0 + 2.4 * ratio**2) ** (17.0 / 6.0)
            * np.exp(-2.25 * (length / cut) ** (4.0 / 3.0))
            * width
        )  # largest at the peak
        energy *= 1.5 * chosen.rms_mm_s**2 / energy.sum()
        directions, first = rng.standard_normal((2, chosen.modes, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        first = np.cross(directions, first)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        angle = rng.uniform(0.0, 2.0 * np.pi, chosen.modes)[:, None]
        second = np.cross(directions, first)
        strength = (
            2.0 * np.sqrt(energy)[:, None]
        )  # a cosine's mean square is a half, and three components share it
        phase = rng.uniform(0.0, 2.0 * np.pi, chosen.modes)[:, None]
        amplitude = strength * (np.cos(angle) * first + np.sin(angle) * second)
        return length[:, None] * directions, amplitude * np.cos(phase), amplitude * np.sin(phase)
