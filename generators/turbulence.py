"""Homogeneous turbulence from random Fourier modes."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import brentq

from sabench.api import F64, Flow, Parameters, stream

_WATER = 1.0  # mm^2/s
_DIRECTIONS = 6  # of waves in a shell: the axes of an icosahedron, isotropic to fourth order
_RATIOS = (1e-5, 1e3)  # Kolmogorov length over the outer length of the spectrum
_SMOOTH = 400  # shells for the limits of the parameters


class TurbulenceParameters(Parameters):
    """Lengths of the field, and number of modes that represent it."""

    rms_mm_s: float = Field(50.0, gt=0.0, description="root mean square of each velocity component")
    integral_mm: float = Field(
        20.0,
        gt=0.0,
        description="integral length: that of the longitudinal correlation f(r) over r",
    )
    kolmogorov_mm: float | None = Field(
        None,
        gt=0.0,
        description="Kolmogorov length, (nu^3 / epsilon)^(1/4); the viscosity nu follows from it",
        examples=[0.5],
    )
    viscosity_mm2_s: float | None = Field(
        None,
        gt=0.0,
        description="kinematic viscosity of the fluid, 1 (water) by default; the Kolmogorov length "
        "follows from it",
    )
    unsteadiness: float = Field(
        0.5,
        ge=0.0,
        description="standard deviation of a mode's angular frequency over the turnover rate "
        "(k^3 E(k))^(1/2) of its wave number k; 0 is frozen",
    )
    modes: int = Field(
        200, ge=60, le=5000, description="number of modes, rounded up to a multiple of 6"
    )
    draw: int = Field(
        1, ge=0, description="number of the random field among those with this spectrum"
    )

    @model_validator(mode="after")
    def _check_lengths(self) -> TurbulenceParameters:
        if self.kolmogorov_mm is not None and self.viscosity_mm2_s is not None:
            raise ValueError(
                "expected kolmogorov_mm or viscosity_mm2_s, one follows from the other; got both"
            )
        low, high = (_Shells.of(ratio, _SMOOTH) for ratio in _RATIOS)
        if self.kolmogorov_mm is not None:
            key, value, unit = "kolmogorov_mm", self.kolmogorov_mm, self.integral_mm
            least, most = low.kolmogorov, high.kolmogorov
            means = f"integral_mm = {self.integral_mm:g}"
        else:
            key, value = "viscosity_mm2_s", self.viscosity_mm2_s or _WATER
            unit, least, most = self.rms_mm_s * self.integral_mm, low.viscosity, high.viscosity
            means = f"rms_mm_s = {self.rms_mm_s:g} and integral_mm = {self.integral_mm:g}"
        if not 1.001 * least < value / unit < 0.99 * most:
            raise ValueError(
                f"expected {key} of {1.001 * least * unit:.2g} to {0.99 * most * unit:.2g} with "
                f"{means}, got {value:g}"
            )
        return self


@dataclass(frozen=True)
class _Shells:
    """Spectrum of von Karman and Pao, in shells of wave numbers.

    E(k) ~ k^4 / (1 + k^2)^(17/6) exp(-2.25 (k eta)^(4/3)), in units of its outer length and of the
    velocity's root mean square. 2.25 is 3/2 of Kolmogorov's constant 1.5: with it, eta is the
    Kolmogorov length of the spectrum (Pao 1965).

    Attributes
    ----------
    ratio : Kolmogorov length.
    numbers, energies, widths : wave number, energy and width (in wave numbers) of each shell.
    """

    ratio: float
    numbers: F64
    energies: F64
    widths: F64

    @classmethod
    def of(cls, ratio: float, count: int) -> _Shells:
        """Cut the spectrum at wave numbers in a geometric sequence."""
        edges = np.geomspace(0.05 * min(1.0, 1.0 / ratio), 4.0 / ratio, count + 1)
        numbers, widths = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)
        falling = np.exp(-2.25 * (numbers * ratio) ** (4.0 / 3.0))
        energies = numbers**4 / (1.0 + numbers**2) ** (17.0 / 6.0) * falling * widths
        return cls(ratio, numbers, 1.5 * energies / energies.sum(), widths)

    @property
    def integral(self) -> float:
        """Integral length, pi / 2 times the integral of E(k) / k."""
        return float(np.pi / 2.0 * (self.energies / self.numbers).sum())

    @property
    def kolmogorov(self) -> float:
        """Kolmogorov length over the integral length."""
        return self.ratio / self.integral

    @property
    def viscosity(self) -> float:
        """Viscosity over the integral length and the velocity's root mean square.

        From eta^4 = nu^3 / epsilon and epsilon = 2 nu times the integral of k^2 E(k).
        """
        gradient = np.sqrt(2.0 * (self.numbers**2 * self.energies).sum())
        return float(self.ratio**2 * gradient / self.integral)


class Turbulence(Flow):
    """Random Fourier modes without divergence, which evolve at their turnover rates.

    Their spectrum is that of von Karman and Pao: k^4 at large lengths, k^(-5/3) at medium ones,
    and a cut-off at small ones. The field is Gaussian: it has no vortex stretching and no
    intermittency, and its small eddies are not swept by the large ones.
    """

    name = "turbulence"
    references = (
        "R. H. Kraichnan, Phys. Fluids 13, 22-31, 1970",
        "Y. H. Pao, Phys. Fluids 8, 1063-1075, 1965",
        "J. C. H. Fung, J. C. R. Hunt, N. A. Malik, R. J. Perkins, J. Fluid Mech. 236, 281-318, "
        "1992",
    )
    Parameters = TurbulenceParameters

    @property
    def kolmogorov_mm(self) -> float:
        """Kolmogorov length of the field."""
        return self._outer_mm * self._shells.ratio

    @property
    def viscosity_mm2_s(self) -> float:
        """Kinematic viscosity of the fluid."""
        chosen: TurbulenceParameters = self.parameters
        return self._shells.viscosity * chosen.rms_mm_s * chosen.integral_mm

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Sum a cos(k x + w t) + b sin(k x + w t) over modes."""
        waves, rates, a, b = self._modes
        out = np.zeros((len(points_mm), 3))
        for first in range(0, len(points_mm), 4096):  # the phases of one part stay in the cache
            phase = points_mm[first : first + 4096] @ waves.T + rates * time_s
            out[first : first + 4096] = np.cos(phase) @ a + np.sin(phase) @ b
        return out

    def gradient(self, points_mm: F64, time_s: float) -> F64:
        """Sum the derivatives of the modes."""
        waves, rates, a, b = self._modes
        out = np.zeros((len(points_mm), 9))
        along_b, along_a = ((v[:, :, None] * waves[:, None]).reshape(-1, 9) for v in (b, a))
        for first in range(0, len(points_mm), 4096):
            phase = points_mm[first : first + 4096] @ waves.T + rates * time_s
            out[first : first + 4096] = np.cos(phase) @ along_b - np.sin(phase) @ along_a
        return out.reshape(-1, 3, 3)

    @functools.cached_property
    def _shells(self) -> _Shells:
        """Shells with the lengths that the parameters state."""
        chosen: TurbulenceParameters = self.parameters
        count = -(-chosen.modes // _DIRECTIONS)

        def excess(log_ratio: float) -> float:
            shells = _Shells.of(float(np.exp(log_ratio)), count)
            if chosen.kolmogorov_mm is not None:
                return float(np.log(shells.kolmogorov * chosen.integral_mm / chosen.kolmogorov_mm))
            viscosity = shells.viscosity * chosen.rms_mm_s * chosen.integral_mm
            return float(np.log(viscosity / (chosen.viscosity_mm2_s or _WATER)))

        return _Shells.of(float(np.exp(brentq(excess, *np.log(_RATIOS), xtol=1e-12))), count)

    @property
    def _outer_mm(self) -> float:
        return float(self.parameters.integral_mm) / self._shells.integral

    @functools.cached_property
    def _modes(self) -> tuple[F64, F64, F64, F64]:
        """Wave vectors (m, 3), angular frequencies (m,) and amplitudes (m, 3).

        Both amplitudes of a mode are perpendicular to its wave and to each other, and as long: the
        six modes of a shell have the same energy in every component.
        """
        chosen: TurbulenceParameters = self.parameters
        shells, rng = self._shells, stream(chosen.draw, "turbulence")
        numbers, energies = shells.numbers / self._outer_mm, shells.energies * chosen.rms_mm_s**2
        turnover = np.sqrt(numbers**3 * energies / (shells.widths / self._outer_mm))
        directions = _icosahedra(rng, len(numbers))
        first = np.cross(directions, rng.standard_normal(directions.shape))
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(directions, first) * rng.choice((-1.0, 1.0), len(first))[:, None]
        rates = chosen.unsteadiness * rng.standard_normal(len(first))
        strength = np.sqrt(2.0 * energies / _DIRECTIONS).repeat(_DIRECTIONS)[:, None]
        waves = numbers.repeat(_DIRECTIONS)[:, None] * directions
        return waves, rates * turnover.repeat(_DIRECTIONS), strength * first, strength * second


def _icosahedra(rng: np.random.Generator, count: int) -> F64:
    """Give the axes (6 count, 3) of icosahedra, each turned at random."""
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    pair = np.array([[0.0, 1.0, golden], [0.0, 1.0, -golden]]) / np.hypot(1.0, golden)
    axes = np.concatenate([np.roll(pair, shift, axis=1) for shift in range(3)])
    turns = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
    return np.asarray((axes @ turns).reshape(-1, 3))
