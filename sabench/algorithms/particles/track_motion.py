"""Motion of particles in a frame from their positions before and after.

A track's positions are those of a body whose jerk is white noise, each with an error of its own.
What is most probable at one of them follows from those around it by generalised least squares, as a
fixed-lag smoother would find it (Y. Bar-Shalom et al., Estimation with applications to tracking and
navigation, Wiley 2001, sections 6.2 and 8.6).
"""

from __future__ import annotations

import numpy as np

from sabench.utils.arrays import F64

_ABSENT = 1e12  # variance of a position that is not there, over the largest other one


def most_probable_motion(
    times: F64,
    position: F64,
    variance: F64,
    velocity: F64,
    spread: F64,
    acceleration: float,
    jerk: float,
) -> tuple[F64, F64]:
    """Estimate the motion at time 0, along each axis on its own.

    Parameters
    ----------
    times : (m,) s.
    position, variance : (n, m, 3) mm, mm2; NaN where a track has no position.
    velocity, spread : (n, 3) what is known of velocities without the positions, mm/s, and its
        variance.
    acceleration : variance of accelerations, mm2/s4, around 0.
    jerk : power of the jerk, mm2/s5.

    Returns
    -------
    (n, 3, 3) the three along each axis, orders before axes; their covariances (n, 3, 3, 3), axes
    first.
    """
    unit = float(np.abs(times).max(initial=0.0)) or 1.0  # of time, so that nothing is lost
    times, jerk = times / unit, jerk * unit**5
    there = np.isfinite(position) & np.isfinite(variance)
    largest = float(variance[there].max(initial=0.0)) + jerk
    noise = np.where(there, variance, _ABSENT * max(largest, 1e-300)).transpose(0, 2, 1)
    terms = np.stack([np.ones_like(times), times, times**2 / 2.0], axis=1)
    covariance = jerk * _jerk_covariance(times) + noise[:, :, :, None] * np.eye(len(times))
    weighed = np.linalg.solve(covariance, np.broadcast_to(terms, (*noise.shape[:2], *terms.shape)))
    matrix = np.einsum("mp,namq->napq", terms, weighed)
    right = np.einsum("namp,nam->nap", weighed, np.nan_to_num(position).transpose(0, 2, 1))
    matrix[:, :, 1, 1] += 1.0 / (spread * unit**2)
    right[:, :, 1] += velocity / (spread * unit)
    matrix[:, :, 2, 2] += 1.0 / (acceleration * unit**4)
    known = np.linalg.inv(matrix)
    state = np.einsum("napq,naq->npa", known, right)
    back = unit ** -np.arange(3.0)
    return state * back[:, None], known * np.outer(back, back)


def _jerk_covariance(times: F64) -> F64:
    """Compute the covariance (m, m) of positions by a jerk of power 1 since time 0.

    Jerks before and after are independent. Between them and a time t the position grows with
    (t - s)^2 / 2, so that two times on one side share the integral of both such squares.
    """
    one, other = np.abs(times)[:, None], np.abs(times)[None, :]
    least, rest = np.minimum(one, other), np.abs(one - other)
    both = least**5 / 20.0 + rest * least**4 / 8.0 + rest**2 * least**3 / 12.0
    return np.where(times[:, None] * times[None, :] > 0.0, both, 0.0)
