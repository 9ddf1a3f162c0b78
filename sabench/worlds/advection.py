"""Advection of particles by velocity fields, exactly or with inertia and weight."""

import itertools

import numpy as np

from sabench.api import Flow
from sabench.scenes.materials import Inertia
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_MOST = 20_000  # velocities of a particle's path between two frames
# particles that share their steps: one fast particle adds no more to these than its own steps
AT_ONCE = 20_000


def advect(flow: Flow, points_mm: F64, start_s: float, end_s: float, tolerance_mm: float) -> F64:
    """Advect particles (n, 3) from one time to another, which may be earlier.

    Parameters
    ----------
    tolerance_mm : largest error of a step of any particle, as Dormand and Prince's eighth-order
        pair estimates it.
    """
    out = np.array(points_mm, dtype=np.float64)
    if start_s == end_s:
        return out
    if (exact := flow.carry(out, start_s, end_s)) is not None:
        return exact
    for first in range(0, len(out), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        out[part] = _advect_together(flow, out[part], start_s, end_s, tolerance_mm)
    return out


def _advect_together(
    flow: Flow, points: F64, start_s: float, end_s: float, tolerance_mm: float
) -> F64:
    """Advect some particles.

    scipy bounds the root mean square over all coordinates; divided by the root of their number, its
    tolerance bounds each of them.
    """
    from scipy.integrate import DOP853  # takes long to load

    calls = itertools.count()

    def complaint(reason: str) -> InputError:
        return InputError(
            f"flow {flow.name}: expected a field that particles can follow for "
            f"{end_s - start_s:g} s to {tolerance_mm:g} mm, but {reason}"
        )

    def velocity(time: float, flat: F64) -> F64:
        velocities = flow.velocity(flat.reshape(-1, 3), time).ravel()
        if next(calls) > _MOST:
            finite = np.isfinite(velocities).all()
            raise complaint(
                "it is not smooth enough" if finite else "its velocities are not finite"
            )
        return velocities

    atol = tolerance_mm / np.sqrt(points.size)
    least = 100.0 * np.finfo(np.float64).eps  # that scipy takes
    path = DOP853(velocity, start_s, points.ravel(), end_s, rtol=least, atol=atol)
    while path.status == "running":
        reason = path.step()
    if path.status == "failed":  # velocities that are not finite, or that change too fast
        raise complaint(f"the integration failed: {reason}")
    return np.asarray(path.y.reshape(-1, 3))


_STEP_S = 1e-6  # of the difference that gives the fluid's acceleration
_LARGEST = 0.2  # Stokes number
_FASTEST = 1.0  # Reynolds number


class InertialFlow(Flow):
    """Velocity of inertial particles, one row of points for each particle.

    v = u + s (g - Du/Dt),  s = (rho_p / rho_f - 1) d^2 / (18 nu)

    It is the slow solution of the equation of motion of Maxey and Riley with drag, added mass,
    pressure gradient and buoyancy, without Basset's and Faxen's terms, to first order in the time
    scale: Maxey, J. Fluid Mech. 174 (1987) 441-465; Ferry and Balachandar, Int. J. Multiphase Flow
    27 (2001) 1199-1226.

    Parameters
    ----------
    flow : of the fluid.
    inertia : densities, viscosity and gravity.
    diameter_mm : (n,) of the particles.
    """

    def __init__(self, flow: Flow, inertia: Inertia, diameter_mm: F64) -> None:
        super().__init__(flow.parameters)
        self._flow, self._gravity = flow, 1e3 * np.asarray(inertia.gravity_m_s2)
        self._response_s = inertia.response_s(diameter_mm)[:, None]
        self.name = flow.name  # type: ignore[misc]  # the flow that errors name

    def velocity(self, points_mm: F64, time_s: float) -> F64:
        """Compute velocities (n, 3) in mm/s of particles at points (n, 3)."""
        fluid = self._flow.velocity(points_mm, time_s)
        once, twice = (
            self._flow.velocity(points_mm, time_s + n * _STEP_S) - fluid for n in (1.0, 2.0)
        )  # forwards only: a field may begin at this time
        carried = np.einsum("nij,nj->ni", self._flow.gradient(points_mm, time_s), fluid)
        acceleration = (4.0 * once - twice) / (2.0 * _STEP_S) + carried
        return np.asarray(fluid + self._response_s * (self._gravity - acceleration))


def velocity_of(
    flow: Flow, inertia: Inertia | None, points_mm: F64, diameter_mm: F64, time_s: float
) -> F64:
    """Compute the velocities of particles; without inertia, those of the fluid."""
    if inertia is None:
        return flow.velocity(points_mm, time_s)
    return InertialFlow(flow, inertia, diameter_mm).velocity(points_mm, time_s)


def move_particles(
    flow: Flow,
    inertia: Inertia | None,
    points_mm: F64,
    diameter_mm: F64,
    start_s: float,
    end_s: float,
    tolerance_mm: float,
) -> F64:
    """Move particles (n, 3) from one time to another, with the fluid but for inertia."""
    if inertia is None:
        return advect(flow, points_mm, start_s, end_s, tolerance_mm)
    moved = np.array(points_mm, dtype=np.float64)
    for first in range(0, len(moved), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        inertial = InertialFlow(flow, inertia, diameter_mm[part])
        moved[part] = advect(inertial, moved[part], start_s, end_s, tolerance_mm)
    return moved


def check_inertia(
    flow: Flow, inertia: Inertia, points_mm: F64, diameter_mm: F64, time_s: float, title: str
) -> None:
    """Raise an InputError for particles that the first order does not describe."""
    if not len(points_mm):
        return
    rate = np.linalg.norm(flow.gradient(points_mm, time_s), ord=2, axis=(1, 2))
    stokes = float((inertia.relaxation_s(diameter_mm) * rate).max())
    inertial = InertialFlow(flow, inertia, diameter_mm).velocity(points_mm, time_s)
    slip = np.linalg.norm(inertial - flow.velocity(points_mm, time_s), axis=1)
    reynolds = float((slip * diameter_mm).max() / inertia.viscosity_mm2_s)
    for what, value, most in (
        ("Stokes number (relaxation time times the gradient)", stokes, _LARGEST),
        ("Reynolds number of their slip", reynolds, _FASTEST),
    ):
        if value > most:
            raise InputError(
                f"{title}: inertia: expected particles with a {what} of at most {most:g}, "
                f"got {value:.3g}"
            )
