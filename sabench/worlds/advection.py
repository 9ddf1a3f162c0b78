"""Advection of particles by velocity fields."""

from __future__ import annotations

import itertools

import numpy as np

from sabench.api import Flow
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError

_RELATIVE = 1e-13  # next to nothing: the least that scipy takes is 100 roundings
_MOST = 20_000  # velocities of a particle's path between two frames
_TRIED, _HOPELESS = 2_000, 4.0  # velocities until its pace tells, and how much too slow it may be
# particles whose paths share their steps: one fast particle costs these no more than its own steps
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
        made = flow.velocity(flat.reshape(-1, 3), time).ravel()
        count, covered = next(calls), (time - start_s) / (end_s - start_s)
        if count > _MOST or (count > _TRIED and covered * _MOST * _HOPELESS < count):
            finite = np.isfinite(made).all()
            raise complaint(
                "it is not smooth enough" if finite else "its velocities are not finite"
            )
        return made

    atol = tolerance_mm / np.sqrt(points.size)
    path = DOP853(velocity, start_s, points.ravel(), end_s, rtol=_RELATIVE, atol=atol)
    while path.status == "running":
        reason = path.step()
    if path.status == "failed":  # velocities that are not finite, or that change too fast
        raise complaint(f"the integration failed: {reason}")
    return np.asarray(path.y.reshape(-1, 3))
