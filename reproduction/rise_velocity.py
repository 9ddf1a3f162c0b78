"""Terminal velocity of single bubbles in a clean liquid: figure 5-23.

Small bubbles are oblate spheroids with a thin boundary layer that slips: Moore, "The velocity of
rise of distorted gas bubbles in a liquid of small viscosity", J. Fluid Mech. 23 (1965), with his
integral of the wake as the polynomial of Loth, Int. J. Multiphase Flow 34 (2008). Large ones move
like waves: equation 7-3 of Clift, Grace and Weber, "Bubbles, Drops, and Particles" (1978). A bubble
rises at the lower of both velocities.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from sabench.utils.arrays import F64

_CAPILLARY, _GRAVITY = 2.14, 0.505  # of the wave-like velocity
_ROUND, _FLATTEST = 1.0 + 1e-4, 3.9  # long over short axis: Moore's Weber number rises up to there
_AXIS_RATIOS = 1000  # of the tabulated spheroids


@dataclass(frozen=True)
class Liquid:
    """Liquid around bubbles of negligible density, in SI units; water by default.

    The viscosity is kinematic, the tension that of the surface.
    """

    density: float = 1000.0
    viscosity: float = 1e-6
    tension: float = 0.073
    gravity: float = 9.81

    @property
    def morton(self) -> float:
        """Morton number, equation 5.4."""
        return self.gravity * self.viscosity**4 * self.density**3 / self.tension**3

    @property
    def slowest_mm(self) -> float:
        """Diameter at the minimum of the wave-like velocity."""
        weight = _GRAVITY * self.density * self.gravity
        return 1e3 * float(np.sqrt(_CAPILLARY * self.tension / weight))


def wave_velocity(diameter_mm: F64, liquid: Liquid) -> F64:
    """Compute the velocity (n,) of large bubbles in m/s; viscosity is negligible."""
    d = 1e-3 * np.asarray(diameter_mm)
    capillary = _CAPILLARY * liquid.tension / (liquid.density * d)
    return np.asarray(np.sqrt(capillary + _GRAVITY * liquid.gravity * d))


def spheroid_velocity(diameter_mm: F64, liquid: Liquid) -> F64:
    """Compute the velocity (n,) in m/s of small bubbles, by Moore's law.

    NaN for bubbles that would be flatter than the law allows. It is accurate from Reynolds numbers
    of about 50.
    """
    return np.array([_balance(1e-3 * d, liquid) for d in np.atleast_1d(diameter_mm)])


def terminal_velocity(diameter_mm: F64, liquid: Liquid) -> F64:
    """Compute the rise velocity (n,) in m/s of bubbles of equivalent diameters."""
    return np.fmin(spheroid_velocity(diameter_mm, liquid), wave_velocity(diameter_mm, liquid))


def transition_diameter_mm(largest_mm: float, liquid: Liquid) -> float:
    """Compute the diameter of the largest bubbles that remain below Y_p.

    They rise as fast as the slowest large bubble: the largest one or, if that is beyond the minimum
    of the velocity, one at the minimum (section 5.5.2). Raises ValueError: the largest bubble is on
    the rising part of the law.
    """
    slow = float(wave_velocity(np.array(min(largest_mm, liquid.slowest_mm)), liquid))
    small = np.linspace(0.2, 2.0, 1801)
    reached = np.flatnonzero(spheroid_velocity(small, liquid) >= slow)
    if not len(reached):
        raise ValueError(f"largest_mm: expected a bubble beyond the fastest, got {largest_mm:g}")
    return float(small[reached[0]])


def moore(ratio: F64) -> tuple[F64, F64, F64]:
    """Compute Moore's Weber number, G and H (n,) by long over short axis.

    The drag coefficient is 48 G / Re (1 + H / sqrt(Re)).
    """
    root, angle = np.sqrt(ratio**2 - 1.0), np.arccos(1.0 / ratio)
    bracket = ratio**2 * angle - root
    weber = 4.0 * ratio ** (-4.0 / 3.0) * (ratio**3 + ratio - 2.0) * bracket**2 / root**6
    dissipated = ratio ** (4.0 / 3.0) * root**3 * (root - (2.0 - ratio**2) * angle)
    wake = np.polyval([0.0195, -0.2134, 1.7026, -2.1461, -1.5732], ratio)
    return np.asarray(weber), np.asarray(dissipated / (3.0 * bracket**2)), np.asarray(wake)


def _balance(d: float, liquid: Liquid) -> float:
    """Find the velocity that balances drag and buoyancy of a bubble; d in m."""
    ratios = np.geomspace(_ROUND, _FLATTEST, _AXIS_RATIOS)
    numbers = moore(ratios)[0]

    def excess(speed: float) -> float:
        number = liquid.density * speed**2 * d / liquid.tension
        _, g, h = moore(np.asarray(np.interp(number, numbers, ratios)))
        re = speed * d / liquid.viscosity
        drag = 48.0 * float(g) / re * (1.0 + float(h) / float(np.sqrt(re)))
        return drag * speed**2 - 4.0 / 3.0 * liquid.gravity * d

    slowest = float(moore(ratios[0])[2]) ** 2 * liquid.viscosity / d  # no drag below
    fastest = float(np.sqrt(numbers[-1] * liquid.tension / (liquid.density * d)))
    if excess(slowest) >= 0.0 or excess(fastest) <= 0.0:
        return float("nan")
    return float(brentq(excess, slowest, fastest))
