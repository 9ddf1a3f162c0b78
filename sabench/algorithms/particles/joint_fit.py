"""Fit of particles to the images of all cameras, one after the other.

A particle takes a Gauss-Newton step against the images less all others, its light is the most
probable one under its prior, and the step counts only if the cost falls. The cost is minus the
logarithm of the probability of images and lights. What a particle must earn to exist is its price:
the other side of the same probability, by Laplace's approximation.
"""

from __future__ import annotations

import math
from typing import Any

from sabench.algorithms.particles.image_model import (
    WEIGHT,
    XX,
    XY,
    YY,
    X,
    Y,
    look,
    paint_here,
    sum_up,
)
from sabench.algorithms.particles.light_prior import (
    factorise,
    find_light,
    guess_light,
    light_cost,
    log_determinant,
)
from sabench.utils.compiled import numba

_FARTHEST_PX = 0.5  # that a particle moves in one step
_STILL = 1e-4  # fall of the cost that is not worth a step


@numba.njit(cache=True)
def cost_of(model: Any, room: Any, light: Any) -> float:
    """Compute the cost of a particle's light after `look`, relative to no light."""
    for c in range(len(light)):
        room.logs[c] = math.log(light[c] / model.typical[c])
    cost = light_cost(room.signal, room.weight, model.typical, model.precision, room.logs)
    return float(cost - room.given[0])


@numba.njit(cache=True)
def best_light(model: Any, room: Any, light: Any) -> float:
    """Fill in the most probable light (camera,) after `look`, from `room.logs` on.

    Returns its cost.
    """
    cost = find_light(
        room.signal, room.weight, model.typical, model.precision, room.logs, room.pull, room.bend
    )
    for c in range(len(light)):
        light[c] = model.typical[c] * math.exp(room.logs[c])
    return float(cost - room.given[0])


@numba.njit(cache=True)
def _add_to_matrix(matrix: Any, slope: Any, sums: Any, light: float) -> None:
    """Add what a camera tells of the position to the normal matrix, after `sum_up`."""
    square, xx, xy, yy = light * light, sums[XX], sums[XY], sums[YY]
    for p in range(3):
        for q in range(3):
            matrix[p, q] += square * (
                slope[0, p] * (xx * slope[0, q] + xy * slope[1, q])
                + slope[1, p] * (xy * slope[0, q] + yy * slope[1, q])
            )


@numba.njit(cache=True)
def _normal_equations(model: Any, room: Any, position: Any, light: Any) -> float:
    """Fill in sums and normal equations of a particle.

    Returns the largest derivative of a pixel by a coordinate.
    """
    sum_up(model, room, position, light)
    room.matrix[:], room.right[:], steepest = 0.0, 0.0, 0.0
    for c in range(len(light)):
        slope = room.slope[c]
        for p in range(3):
            steepest = max(steepest, abs(slope[0, p]), abs(slope[1, p]))
            room.right[p] += light[c] * (
                slope[0, p] * room.sums[c, X] + slope[1, p] * room.sums[c, Y]
            )
        _add_to_matrix(room.matrix, slope, room.sums[c], light[c])
    return steepest


@numba.njit(cache=True)
def solve_three(matrix: Any, right: Any, step: Any) -> float:
    """Solve three equations by cofactors.

    Returns the determinant, 0 where it is lost in rounding.
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


@numba.njit(cache=True)
def _fits_already(model: Any, room: Any, light: Any) -> bool:
    """Say whether no step of position or light would lower the cost notably.

    After `_normal_equations`, and with the step of the position in `room.trial`. The prior of light
    bends the cost at least as much as its widest direction.
    """
    fall = 0.0
    for p in range(3):
        fall += 0.5 * room.trial[p] * room.right[p]
    for c in range(len(light)):
        room.logs[c] = math.log(light[c] / model.typical[c])
    for c in range(len(light)):
        pull = 0.0
        for k in range(len(light)):
            pull += model.precision[c, k] * room.logs[k]
        square = light[c] * light[c] * room.weight[c]
        slope = pull + square - light[c] * room.signal[c]
        fall += 0.5 * slope * slope / (square + model.least_precision)
    return fall < _STILL


@numba.njit(cache=True)
def adjust(model: Any, room: Any, particles: Any, n: int) -> float:
    """Fit a particle to the images less all others; returns the change of the cost.

    A step that raises the cost is not taken, nor one that hardly lowers it.
    """
    position, light = particles.position[n], particles.light[n]
    steepest = _normal_equations(model, room, position, light)
    solved = solve_three(room.matrix, room.right, room.trial) > 0.0
    if solved and _fits_already(model, room, light):
        return 0.0
    before = cost_of(model, room, light)
    paint_here(model, room, light, 1.0)
    lowered, cost = False, before
    if solved:
        largest = max(abs(room.trial[0]), abs(room.trial[1]), abs(room.trial[2]))
        share = min(1.0, _FARTHEST_PX / max(steepest * largest, 1e-300))
        for p in range(3):
            room.trial[p] = min(max(position[p] + share * room.trial[p], -1.0), 1.0)
        look(model, room, room.trial, light)
        cost = best_light(model, room, room.light)
        if cost <= before:
            position[:] = room.trial
            lowered = True
    if not lowered:
        look(model, room, position, light)
        cost_of(model, room, light)  # the search starts from the present light
        cost = best_light(model, room, room.light)
    if cost <= before:
        light[:] = room.light
    paint_here(model, room, light, -1.0)
    return float(min(cost - before, 0.0))


@numba.njit(cache=True, nogil=True)
def refine(model: Any, room: Any, particles: Any, rows: Any) -> float:
    """Fit particles (rows) one after the other; returns the change of the cost."""
    total = 0.0
    for n in rows:
        total += adjust(model, room, particles, n)
    return total


@numba.njit(cache=True, nogil=True)
def start_light(model: Any, room: Any, particles: Any, rows: Any) -> None:
    """Give particles (rows) the light that those before leave them."""
    for n in rows:
        particles.light[n] = 0.0
        look(model, room, particles.position[n], particles.light[n])
        guess_light(room.signal, room.weight, model.typical, room.logs)
        best_light(model, room, particles.light[n])
        paint_here(model, room, particles.light[n], -1.0)


@numba.njit(cache=True)
def price(model: Any, room: Any, position: Any, light: Any) -> float:
    """Compute what a particle must earn to be probable, in units of the cost.

    It is minus the logarithm of the particles expected in the volume that its place is known to,
    and of how much narrower the images make its light than the prior: the better they tell both,
    the less probable it is to find them there by chance.
    """
    sum_up(model, room, position, light)
    room.matrix[:] = 0.0
    for c in range(len(light)):
        for k in range(len(light)):
            room.bend[c, k] = model.precision[c, k]
        room.bend[c, c] += light[c] * light[c] * room.sums[c, WEIGHT]
        _add_to_matrix(room.matrix, room.slope[c], room.sums[c], light[c])
    factorise(room.bend)
    known = 0.5 * (log_determinant(room.bend) - model.log_precision)
    determinant = solve_three(room.matrix, room.right, room.trial)
    known += 0.5 * math.log(max(determinant, 1e-300)) - 1.5 * math.log(2.0 * math.pi)
    return float(known - model.log_rate)
