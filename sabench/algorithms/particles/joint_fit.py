"""Fit of particles to the images of all cameras, one particle after the other.

A particle takes a Gauss-Newton step against the images less all others, its light is the most
probable one under its prior, and the step counts only if the cost falls. The cost is minus the
logarithm of the probability of images and lights. What a particle must gain to be kept is its
penalty: the other side of the same probability, by Laplace's approximation.

The prior of light: the logarithms of a particle's light over a typical particle's follow a normal
distribution of all cameras. Particles differ (their size), and each differs between cameras (its
lobes of scattering). A ghost combines images of different particles and seldom follows it. The
covariance is learned from particles that stand alone.
"""

import math
from typing import Any

import numpy as np
from scipy.special import gammainc, gammaincinv

from sabench.algorithms.particles.image_model import Sum, copy_row, look, paint_here, sum_up
from sabench.utils.arrays import F64
from sabench.utils.compiled import inner_kernel, numba

# Light:
_LIGHT_STEPS, _LIGHT_STILL = 12, 0.01  # of Newton's method, and the step that is the last
_CLIP = 0.97  # share of the particles that the covariance comes from
OWN_ERROR = 0.03  # of the model of images, over a particle's light: particles differ

# Positions:
FARTHEST_PX = 0.5  # that a particle, or a camera, moves in one step


def even_covariance(cameras: int, between: float, common: float) -> F64:
    """Make a covariance of equal scatter between cameras, and a common one."""
    return np.asarray(between**2 * np.eye(cameras) + common**2 * np.ones((cameras, cameras)))


def scatter_between(covariance: F64) -> float:
    """Compute the scatter of a camera's logarithm without what is common to all."""
    cameras = len(covariance)
    variance = np.trace(covariance) / cameras
    shared = (covariance.sum() - np.trace(covariance)) / max(cameras * (cameras - 1), 1)
    return math.sqrt(max(variance - shared, 0.0))


def learn_covariance(logarithms: F64) -> F64:
    """Learn the covariance of logarithms (n, camera) about their medians.

    The most unusual particles do not count; normal ones without them have less scatter by a factor
    (C. Croux and G. Haesbroeck, J. Multivariate Anal. 71, 161-190, 1999). Of as many more particles
    as there are cameras, all cameras have the average scatter.
    """
    off, cameras = logarithms - np.median(logarithms, axis=0), logarithms.shape[1]
    for _ in range(2):
        covariance = off.T @ off / len(off) + 1e-4 * np.eye(cameras)
        far = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
        off = off[far <= np.quantile(far, _CLIP)]
    kept, half = len(off) / len(logarithms), 0.5 * cameras
    covariance = off.T @ off / (len(logarithms) * gammainc(half + 1.0, gammaincinv(half, kept)))
    between = scatter_between(covariance)
    common = math.sqrt(max(np.trace(covariance) / cameras - between**2, 0.0))
    more = cameras / (cameras + len(off))
    covariance = (1.0 - more) * covariance + more * even_covariance(cameras, between, common)
    return np.asarray(covariance + OWN_ERROR**2 * np.eye(cameras))


@inner_kernel()
def light_cost(signal: Any, weight: Any, typical: Any, precision: Any, logs: Any) -> float:
    """Compute the cost of lights relative to no light, without constants."""
    cost = 0.0
    for c in range(len(logs)):
        light = typical[c] * math.exp(logs[c])
        pull = 0.0
        for k in range(len(logs)):
            pull += precision[c, k] * logs[k]
        cost += light * (0.5 * light * weight[c] - signal[c]) + 0.5 * logs[c] * pull
    return cost


@numba.njit(inline="always")
def find_light(
    signal: Any, weight: Any, typical: Any, precision: Any, logs: Any, slope: Any, bend: Any
) -> float:
    """Improve logarithms (camera,) by Newton's method; return their cost.

    `bend` is scratch.
    """
    cameras = len(logs)
    for _ in range(_LIGHT_STEPS):
        for c in range(cameras):
            light = typical[c] * math.exp(logs[c])
            pull = 0.0
            for k in range(cameras):
                pull += precision[c, k] * logs[k]
                bend[c, k] = precision[c, k]
            square = light * light * weight[c]
            slope[c] = square - light * signal[c] + pull
            bend[c, c] += max(2.0 * square - light * signal[c], 0.5 * square)
        factorise_cholesky(bend)
        _substitute(bend, slope)
        largest = 0.0
        for c in range(cameras):
            largest = max(largest, abs(slope[c]))
        share = min(1.0, 1.0 / max(largest, 1e-300))
        for c in range(cameras):
            logs[c] -= share * slope[c]
        if largest < _LIGHT_STILL:
            break
    return float(light_cost(signal, weight, typical, precision, logs))


@inner_kernel()
def factorise_cholesky(matrix: Any) -> None:
    """Replace a positive definite matrix by its Cholesky factor."""
    for i in range(len(matrix)):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(value, 1e-12))
            else:
                matrix[i, j] = value / matrix[j, j]


@numba.njit(inline="always")
def log_determinant(factor: Any) -> float:
    """Compute the logarithm of the determinant of a factorised matrix."""
    total = 0.0
    for i in range(len(factor)):
        total += math.log(factor[i, i])
    return 2.0 * total


@numba.njit(inline="always")
def _substitute(factor: Any, right: Any) -> None:
    count = len(right)
    for i in range(count):
        value = right[i]
        for k in range(i):
            value -= factor[i, k] * right[k]
        right[i] = value / factor[i, i]
    for i in range(count - 1, -1, -1):
        value = right[i]
        for k in range(i + 1, count):
            value -= factor[k, i] * right[k]
        right[i] = value / factor[i, i]


@inner_kernel()
def cost_of(model: Any, room: Any, light: Any) -> float:
    """Compute the cost of a particle's light after `look`, relative to no light."""
    for c in range(len(light)):
        room.logs[c] = math.log(light[c] / model.typical[c])
    cost = light_cost(room.signal, room.weight, model.typical, model.precision, room.logs)
    return float(cost - room.given[0])


@inner_kernel()
def best_light(model: Any, room: Any, light: Any) -> float:
    """Fill in the most probable light (camera,) after `look`; returns its cost."""
    cost = find_light(
        room.signal, room.weight, model.typical, model.precision, room.logs, room.pull, room.bend
    )
    for c in range(len(light)):
        light[c] = model.typical[c] * math.exp(room.logs[c])
    return float(cost - room.given[0])


@inner_kernel()
def _add_to_matrix(room: Any, c: int, light: float) -> None:
    """Add a camera's share of the position's normal matrix, after `sum_up`."""
    square, slope, sums = light * light, room.slope[c], room.sums
    xx, xy, yy = sums[c, Sum.XX], sums[c, Sum.XY], sums[c, Sum.YY]
    for p in range(3):
        for q in range(3):
            room.matrix[p, q] += square * (
                slope[0, p] * (xx * slope[0, q] + xy * slope[1, q])
                + slope[1, p] * (xy * slope[0, q] + yy * slope[1, q])
            )


@inner_kernel()
def _normal_equations(model: Any, room: Any, position: Any, light: Any) -> float:
    """Fill in a particle's equations; returns the largest derivative of a pixel."""
    sum_up(model, room, position, light)
    room.matrix[:], room.right[:], steepest = 0.0, 0.0, 0.0
    for c in range(len(light)):
        slope = room.slope[c]
        for p in range(3):
            steepest = max(steepest, abs(slope[0, p]), abs(slope[1, p]))
            room.right[p] += light[c] * (
                slope[0, p] * room.sums[c, Sum.X] + slope[1, p] * room.sums[c, Sum.Y]
            )
        _add_to_matrix(room, c, light[c])
    return steepest


@inner_kernel()
def solve_three(matrix: Any, right: Any, step: Any) -> float:
    """Solve three equations by cofactors; return the determinant.

    It is 0 if it is lost in rounding.
    """
    a = matrix[1, 1] * matrix[2, 2] - matrix[1, 2] * matrix[2, 1]
    b = matrix[1, 2] * matrix[2, 0] - matrix[1, 0] * matrix[2, 2]
    c = matrix[1, 0] * matrix[2, 1] - matrix[1, 1] * matrix[2, 0]
    determinant = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2] * c
    if not determinant > 1e-9 * matrix[0, 0] * matrix[1, 1] * matrix[2, 2]:
        return 0.0
    for p in range(3):
        q, r = (p + 1) % 3, (p + 2) % 3
        total = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            cofactor = matrix[j, q] * matrix[k, r] - matrix[j, r] * matrix[k, q]
            total += cofactor * right[i]
        step[p] = total / determinant
    return float(determinant)


@inner_kernel()
def fit_particle(model: Any, room: Any, particles: Any, n: int) -> float:
    """Fit a particle to the images less all others; return the change of cost.

    The particle changes only if the cost falls.
    """
    position, light = particles.position[n], particles.light[n]
    steepest = _normal_equations(model, room, position, light)
    solved = solve_three(room.matrix, room.right, room.trial) > 0.0
    before = cost_of(model, room, light)
    paint_here(model, room, light, 1.0)
    lowered, cost = False, before
    if solved:
        largest = max(abs(room.trial[0]), abs(room.trial[1]), abs(room.trial[2]))
        share = min(1.0, FARTHEST_PX / max(steepest * largest, 1e-300))
        for p in range(3):
            room.trial[p] = min(max(position[p] + share * room.trial[p], -1.0), 1.0)
        look(model, room, room.trial, light)
        cost = best_light(model, room, room.light)
        if cost <= before:
            copy_row(room.trial, position)
            lowered = True
    if not lowered:
        look(model, room, position, light)
        cost_of(model, room, light)  # the search starts from the present light
        cost = best_light(model, room, room.light)
    if cost <= before:
        copy_row(room.light, light)
    paint_here(model, room, light, -1.0)
    return float(min(cost - before, 0.0))


@numba.njit(cache=True, nogil=True)
def fit_particles(model: Any, room: Any, particles: Any, rows: Any) -> float:
    """Fit particles (rows) one after the other; returns the change of the cost."""
    total = 0.0
    for n in rows:
        total += fit_particle(model, room, particles, n)
    return total


@numba.njit(cache=True, nogil=True)
def start_light(model: Any, room: Any, particles: Any, rows: Any) -> None:
    """Give particles (rows) the light that those before leave them."""
    for n in rows:
        particles.light[n] = 0.0
        look(model, room, particles.position[n], particles.light[n])
        room.logs[:] = 0.0
        best_light(model, room, particles.light[n])
        paint_here(model, room, particles.light[n], -1.0)


@inner_kernel()
def penalty(model: Any, room: Any, position: Any, light: Any) -> float:
    """Compute what a particle must gain to be probable, in units of the cost.

    It is minus the logarithm of the particles expected in the volume of its position's errors,
    and of how much narrower the images make its light than the prior: the smaller both are,
    the less probable it is to find them there by chance.
    """
    sum_up(model, room, position, light)
    room.matrix[:] = 0.0
    for c in range(len(light)):
        for k in range(len(light)):
            room.bend[c, k] = model.precision[c, k]
        room.bend[c, c] += light[c] * light[c] * room.sums[c, Sum.WEIGHT]
        _add_to_matrix(room, c, light[c])
    factorise_cholesky(room.bend)
    information = 0.5 * (log_determinant(room.bend) - model.log_precision)
    determinant = solve_three(room.matrix, room.right, room.trial)
    information += 0.5 * math.log(max(determinant, 1e-300)) - 1.5 * math.log(2.0 * math.pi)
    return float(information - model.log_rate)
