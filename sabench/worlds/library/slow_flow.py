"""Steady viscous flow around bodies at rest, in a periodic box.

Forces in the bodies' nodes bring the fluid there to rest (immersed boundaries: Peskin, Acta
Numerica 11 (2002) 479-517). They act through the Green's function of Oseen's equations in a
periodic box (without convection: Hasimoto, J. Fluid Mech. 5 (1959) 317-328). The vector potential
of the flow is interpolated by cubic splines; their curl is free of divergence everywhere.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.api.truth import Solid
from sabench.geometry.grid import vorticity
from sabench.utils.arrays import F64, Bool
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.errors import InputError
from sabench.utils.threads import on_cores
from sabench.worlds.library.overlaps import contains

_AT_REST = 1e-3  # of the mean flow: the speed that is left in the bodies, root mean square
_ITERATIONS = 400


@dataclass(frozen=True)
class PeriodicBox:
    """Periodic lattice.

    Attributes
    ----------
    low_mm : (3,) position of the first node.
    step_mm : of the lattice, along all axes.
    shape : nodes along x, y, z.
    """

    low_mm: F64
    step_mm: float
    shape: tuple[int, int, int]

    def points_mm(self) -> F64:
        """Compute the positions (n, 3) of all nodes, z fastest."""
        axes = np.meshgrid(*(np.arange(count) for count in self.shape), indexing="ij")
        return np.asarray(self.low_mm + self.step_mm * np.stack([a.ravel() for a in axes], 1))

    def waves(self) -> F64:
        """Compute the wave vectors (x, y, z, 3) of a real transform, 1/mm."""
        k = [2.0 * np.pi * np.fft.fftfreq(count, self.step_mm) for count in self.shape[:2]]
        k.append(2.0 * np.pi * np.fft.rfftfreq(self.shape[2], self.step_mm))
        return np.stack(np.meshgrid(*k, indexing="ij"), axis=-1)


@dataclass(frozen=True, eq=False)
class SlowFlow:
    """Flow on the lattice of a box.

    Attributes
    ----------
    mean_mm_s : (3,) mean velocity over the box.
    splines : (x, y, z, 3) coefficients of the vector potential's cubic splines, mm2/s.
    force : (3,) of the fluid on the bodies over its density, mm4/s2.
    """

    box: PeriodicBox
    mean_mm_s: F64
    splines: F64
    force: F64

    def velocity(self, points_mm: F64) -> F64:
        """Compute velocities (n, 3) at points (n, 3), the box repeated."""
        return np.asarray(self.mean_mm_s + vorticity(self._derivatives(points_mm, 1)))

    def gradient(self, points_mm: F64) -> F64:
        """Compute gradients (n, 3, 3), du_i / dx_j."""
        second = self._derivatives(points_mm, 2)
        return vorticity(second.transpose(0, 3, 1, 2)).transpose(0, 2, 1).copy()

    def _derivatives(self, points_mm: F64, order: int) -> F64:
        """Compute the vector potential's derivatives (n, component, axis, ...)."""
        axes = np.array(list(itertools.product(range(3), repeat=order)))
        counts = (axes[:, :, None] == np.arange(3)).sum(axis=1)  # along each axis
        out = np.empty((len(points_mm), 3, len(counts)))
        places = (points_mm - self.box.low_mm) / self.box.step_mm
        on_cores(_derive, len(out), self.splines, places, counts, out)
        out /= self.box.step_mm**order
        return out.reshape(len(out), *[3] * (1 + order))


def solve_oseen(
    bodies: Sequence[Solid], box: PeriodicBox, velocity_mm_s: F64, viscosity_mm2_s: float
) -> SlowFlow:
    """Solve Oseen's equations with a mean velocity and bodies at rest.

    Convection is that by the mean velocity: exact for slow flow, and a model of the wake at larger
    Reynolds numbers.

    Raises InputError: bodies that hold no node, or no solution within the iterations.
    """
    from scipy.sparse.linalg import LinearOperator, gmres  # takes long to load

    points = box.points_mm()
    solid = np.any([contains(body, points) for body in bodies], axis=0)
    if not solid.any():
        sentence = f"step_mm: expected bodies that hold nodes, got none {box.step_mm:g} mm apart"
        raise InputError(sentence)
    green = _Oseen(box, velocity_mm_s, viscosity_mm2_s)
    count = 3 * int(solid.sum())

    def answer(force: F64) -> F64:
        velocity = green.velocity(_spread(force.reshape(-1, 3), solid, box))
        return velocity.reshape(-1, 3)[solid].ravel()

    wanted = -np.tile(velocity_mm_s, count // 3)
    operator = LinearOperator((count, count), matvec=answer, dtype=np.float64)
    force, failed = gmres(operator, wanted, rtol=_AT_REST, restart=60, maxiter=_ITERATIONS // 60)
    if failed:
        raise InputError(
            "step_mm: expected a lattice on which the flow converges, but the fluid in the bodies "
            f"still moves after {_ITERATIONS} iterations"
        )
    spread = _spread(force.reshape(-1, 3), solid, box)
    total = -spread.reshape(-1, 3).sum(axis=0) * box.step_mm**3
    return SlowFlow(box, velocity_mm_s, green.splines(spread), total)


def _spread(values: F64, solid: Bool, box: PeriodicBox) -> F64:
    """Put values (n, 3) of the bodies' nodes on the lattice (x, y, z, 3)."""
    out = np.zeros((len(solid), 3))
    out[solid] = values
    return out.reshape(*box.shape, 3)


class _Oseen:
    """Green's function in a periodic box, from forces over density."""

    def __init__(self, box: PeriodicBox, mean_mm_s: F64, viscosity_mm2_s: float) -> None:
        self._box, self._k = box, box.waves()
        square = (self._k**2).sum(axis=-1)
        square[0, 0, 0] = 1.0
        answer = 1.0 / (viscosity_mm2_s * square + 1j * (self._k @ mean_mm_s))
        answer[0, 0, 0] = 0.0
        self._square, self._answer = square, answer

    def _modes(self, force: F64) -> Any:
        from scipy import fft

        modes = fft.rfftn(force, axes=(0, 1, 2))
        along = (self._k * modes).sum(axis=-1) / self._square
        modes -= along[..., None] * self._k
        modes *= self._answer[..., None]
        return modes

    def velocity(self, force: F64) -> F64:
        """Compute the velocity (x, y, z, 3) that a force (x, y, z, 3) drives."""
        from scipy import fft

        return np.asarray(fft.irfftn(self._modes(force), self._box.shape, axes=(0, 1, 2)))

    def splines(self, force: F64) -> F64:
        """Compute the spline coefficients of that velocity's vector potential.

        With curl u = w, A = w / k^2; a periodic cubic spline's coefficients are the values over the
        transform of its samples, (2 + cos k h) / 3 along each axis.
        """
        from scipy import fft

        modes = 1j * np.cross(self._k, self._modes(force)) / self._square[..., None]
        samples = ((2.0 + np.cos(self._k * self._box.step_mm)) / 3.0).prod(axis=-1)
        modes /= samples[..., None]
        return np.ascontiguousarray(fft.irfftn(modes, self._box.shape, axes=(0, 1, 2)))


@inner_kernel()
def _weights(part: float, out: Any) -> None:
    """Fill values, slopes and bends (3, 4) of the four cubic B-splines."""
    t, r = part, 1.0 - part
    out[0, 0], out[0, 3] = r * r * r / 6.0, t * t * t / 6.0
    out[0, 1] = 2.0 / 3.0 - t * t + t * t * t / 2.0
    out[0, 2] = 2.0 / 3.0 - r * r + r * r * r / 2.0
    out[1, 0], out[1, 3] = -r * r / 2.0, t * t / 2.0
    out[1, 1] = -2.0 * t + 1.5 * t * t
    out[1, 2] = 2.0 * r - 1.5 * r * r
    out[2, 0], out[2, 3] = r, t
    out[2, 1] = -2.0 + 3.0 * t
    out[2, 2] = -2.0 + 3.0 * r


@numba.njit(cache=True, nogil=True)
def _derive(jobs: slice, splines: Any, places: Any, counts: Any, out: Any) -> None:
    """Fill derivatives (n, component, k) at places (n, 3) in steps.

    `counts` (k, 3) are the numbers of derivatives along each axis.
    """
    shape = splines.shape
    for n in range(jobs.start, jobs.stop):
        weight, first = np.empty((3, 3, 4)), np.empty(3, dtype=np.int64)
        for axis in range(3):
            whole = np.floor(places[n, axis])
            first[axis] = int(whole) - 1
            _weights(places[n, axis] - whole, weight[axis])
        out[n] = 0.0
        for i in range(4):
            a = (first[0] + i) % shape[0]
            for j in range(4):
                b = (first[1] + j) % shape[1]
                for k in range(4):
                    c = (first[2] + k) % shape[2]
                    for q in range(len(counts)):
                        share = weight[0, counts[q, 0], i] * weight[1, counts[q, 1], j]
                        share *= weight[2, counts[q, 2], k]
                        for m in range(3):
                            out[n, m, q] += share * splines[a, b, c, m]
