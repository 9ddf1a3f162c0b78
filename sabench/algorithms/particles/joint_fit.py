"""Fit of particles to the images of all cameras, one after the other.

A particle takes a Gauss-Newton step against the images less all others, its light is the most
probable one under its prior, and the step counts only if the cost falls. The cost is minus the
logarithm of the probability of images and lights. What a particle must earn to exist is its price:
the other side of the same probability, by Laplace's approximation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from sabench.algorithms.particles.light_prior import (
    factorise,
    find_light,
    guess_light,
    light_cost,
    log_determinant,
)
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point
from sabench.images.gaussians import fill_shares, fill_slopes
from sabench.utils.arrays import F32, F64

_REACH, _ROUNDED_PX = 3.1, 0.1  # of a particle's image in widths; that much less is enough
_FARTHEST_PX = 0.5  # that a particle moves in one step
_UNSEEN = 1e-12  # weight of an image that a camera does not see
_WEIGHT, _PULL, _XX, _XY, _YY, _X, _Y = range(7)  # of `sum_up`
SUMS = 7


class ImageModel(NamedTuple):
    """Images as sums of particles' images, and what is left of them.

    Attributes
    ----------
    maps : cameras.
    widths : (camera, 2, 4) widths of particle images along columns and rows, px: in the box's
        middle, and their change along each of its coordinates.
    typical : (camera,) a typical particle's light.
    precision : (camera, camera) inverse covariance of the logarithms of light.
    log_precision : logarithm of its determinant.
    weight : (camera, row, column) float32, 1 / variance of a pixel; 0 where it is unknown.
    left : the same shape, the images less all particles; kept up to date.
    log_rate : logarithm of the number of particles in a unit cube of the box's coordinates.
    """

    maps: VolumePolynomials
    widths: F64
    typical: F64
    precision: F64
    log_precision: float
    weight: F32
    left: F32
    log_rate: float


class Particles(NamedTuple):
    """Particles of a model.

    Attributes
    ----------
    position : (n, 3) in the box of the maps.
    light : (n, camera), in units of the images times px2.
    alive : (n,) whether a row is a particle.
    """

    position: F64
    light: F64
    alive: Any


class Room(NamedTuple):
    """Room to work in: profiles of one particle's images and their sums, by camera.

    Windows of the images are as many pixels wide and high as the profiles are long, an odd number.
    """

    x: F64
    y: F64
    by_x: F64
    by_y: F64
    corner: Any
    slope: F64
    here: F64
    width: F64
    sums: F64
    signal: F64
    weight: F64
    logs: F64
    pull: F64
    bend: F64
    matrix: F64
    right: F64
    trial: F64
    light: F64


def make_room(sigma: F64) -> Room:
    """Make the arrays that kernels work in, for images of a width (camera, 2)."""
    cameras, half = len(sigma), math.ceil(_REACH * float(sigma.max()) - _ROUNDED_PX)
    window = 2 * half + 1
    return Room(
        x=np.zeros((cameras, window)),
        y=np.zeros((cameras, window)),
        by_x=np.zeros((cameras, window)),
        by_y=np.zeros((cameras, window)),
        corner=np.zeros((cameras, 2), dtype=np.int64),
        slope=np.zeros((cameras, 2, 3)),
        here=np.zeros(2),
        width=np.zeros(2),
        sums=np.zeros((cameras, SUMS)),
        signal=np.zeros(cameras),
        weight=np.zeros(cameras),
        logs=np.zeros(cameras),
        pull=np.zeros(cameras),
        bend=np.zeros((cameras, cameras)),
        matrix=np.zeros((3, 3)),
        right=np.zeros(3),
        trial=np.zeros(3),
        light=np.zeros(cameras),
    )


@numba.njit(cache=True)
def set_profile(model: Any, room: Any, c: int, position: Any) -> None:
    """Project a position to a camera and fill in the profiles of its image there."""
    project_point(model.maps, c, position, room.here, room.slope[c])
    corner, half = room.corner[c], len(room.x[c]) // 2
    for k in range(2):
        corner[k] = round(room.here[k]) - half
        width = model.widths[c, k, 0]
        for p in range(3):
            width += model.widths[c, k, p + 1] * position[p]
        room.width[k] = width
    fill_shares(room.here[0], room.width[0], corner[0], room.x[c])
    fill_shares(room.here[1], room.width[1], corner[1], room.y[c])


@numba.njit(cache=True)
def set_slopes(room: Any, c: int) -> None:
    """Fill in the profiles' derivatives, just after the profiles of the same camera."""
    fill_slopes(room.here[0], room.width[0], room.corner[c, 0], room.by_x[c])
    fill_slopes(room.here[1], room.width[1], room.corner[c, 1], room.by_y[c])


@numba.njit(cache=True)
def _paint(model: Any, room: Any, c: int, amount: float) -> None:
    """Add light of the current profile to what is left of an image."""
    image, column, row = model.left[c], room.corner[c, 0], room.corner[c, 1]
    rows, columns = image.shape
    for i in range(max(0, -row), min(len(room.y[c]), rows - row)):
        share = amount * room.y[c, i]
        for j in range(max(0, -column), min(len(room.x[c]), columns - column)):
            image[row + i, column + j] += np.float32(share * room.x[c, j])


@numba.njit(cache=True)
def take_out(model: Any, room: Any, position: Any, light: Any) -> None:
    """Give the light of a particle back to what is left of the images."""
    for c in range(len(light)):
        set_profile(model, room, c, position)
        _paint(model, room, c, light[c])


@numba.njit(cache=True)
def put_in(model: Any, room: Any, position: Any, light: Any) -> None:
    """Subtract the light of a particle from what is left of the images."""
    for c in range(len(light)):
        set_profile(model, room, c, position)
        _paint(model, room, c, -light[c])


@numba.njit(cache=True)
def look(model: Any, room: Any, position: Any) -> None:
    """Sum up what the images less all others say of a particle at a position."""
    for c in range(len(room.signal)):
        set_profile(model, room, c, position)
        image, weights = model.left[c], model.weight[c]
        column, row = room.corner[c, 0], room.corner[c, 1]
        rows, columns = image.shape
        signal, weight = 0.0, 0.0
        for i in range(max(0, -row), min(len(room.y[c]), rows - row)):
            for j in range(max(0, -column), min(len(room.x[c]), columns - column)):
                own = room.y[c, i] * room.x[c, j]
                each = own * weights[row + i, column + j]
                signal += each * image[row + i, column + j]
                weight += each * own
        seen = weight > _UNSEEN
        room.signal[c], room.weight[c] = signal if seen else 0.0, weight if seen else 0.0


@numba.njit(cache=True)
def cost_of(model: Any, room: Any, light: Any) -> float:
    """Compute the cost of a particle's light after `look`, relative to no light."""
    for c in range(len(light)):
        room.logs[c] = math.log(light[c] / model.typical[c])
    return float(light_cost(room.signal, room.weight, model.typical, model.precision, room.logs))


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
    return float(cost)


@numba.njit(cache=True)
def sum_up(model: Any, room: Any, c: int, position: Any) -> None:
    """Fill in a camera's sums of weights, of a particle whose light is subtracted.

    Squares of its image, products with what is left, squares of the image's derivatives (three),
    and their products with what is left (two); all for light 1.
    """
    set_profile(model, room, c, position)
    set_slopes(room, c)
    image, weights, sums = model.left[c], model.weight[c], room.sums[c]
    column, row = room.corner[c, 0], room.corner[c, 1]
    rows, columns = image.shape
    weight = pull = xx = xy = yy = x = y = 0.0
    for i in range(max(0, -row), min(len(room.y[c]), rows - row)):
        for j in range(max(0, -column), min(len(room.x[c]), columns - column)):
            own = room.y[c, i] * room.x[c, j]
            dx, dy = room.y[c, i] * room.by_x[c, j], room.by_y[c, i] * room.x[c, j]
            each = weights[row + i, column + j]
            off = each * image[row + i, column + j]
            weight += each * own * own
            pull += off * own
            x, y = x + off * dx, y + off * dy
            xx, xy, yy = xx + each * dx * dx, xy + each * dx * dy, yy + each * dy * dy
    sums[_WEIGHT], sums[_PULL], sums[_XX], sums[_XY], sums[_YY] = weight, pull, xx, xy, yy
    sums[_X], sums[_Y] = x, y


@numba.njit(cache=True)
def _add_to_matrix(room: Any, c: int, light: float) -> None:
    """Add what a camera tells of the position to the normal matrix, after `sum_up`."""
    square, slope = light * light, room.slope[c]
    xx, xy, yy = room.sums[c, _XX], room.sums[c, _XY], room.sums[c, _YY]
    for p in range(3):
        for q in range(3):
            room.matrix[p, q] += square * (
                slope[0, p] * (xx * slope[0, q] + xy * slope[1, q])
                + slope[1, p] * (xy * slope[0, q] + yy * slope[1, q])
            )


@numba.njit(cache=True)
def _normal_equations(model: Any, room: Any, position: Any, light: Any) -> float:
    """Fill in sums and normal equations of a particle, and give its light back.

    Returns the largest derivative of a pixel by a coordinate.
    """
    room.matrix[:], room.right[:], steepest = 0.0, 0.0, 0.0
    for c in range(len(light)):
        sum_up(model, room, c, position)
        _paint(model, room, c, light[c])
        weight, pull = room.sums[c, _WEIGHT], room.sums[c, _PULL]
        seen = weight > _UNSEEN
        room.signal[c] = pull + light[c] * weight if seen else 0.0
        room.weight[c] = weight if seen else 0.0
        slope = room.slope[c]
        for p in range(3):
            steepest = max(steepest, abs(slope[0, p]), abs(slope[1, p]))
            room.right[p] += light[c] * (
                slope[0, p] * room.sums[c, _X] + slope[1, p] * room.sums[c, _Y]
            )
        _add_to_matrix(room, c, light[c])
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
def adjust(model: Any, room: Any, particles: Any, n: int) -> float:
    """Fit a particle to the images less all others; returns the change of the cost.

    A step that raises the cost is not taken.
    """
    position, light = particles.position[n], particles.light[n]
    steepest = _normal_equations(model, room, position, light)
    before = cost_of(model, room, light)
    lowered, cost = False, before
    if solve_three(room.matrix, room.right, room.trial) > 0.0:
        largest = max(abs(room.trial[0]), abs(room.trial[1]), abs(room.trial[2]))
        share = min(1.0, _FARTHEST_PX / max(steepest * largest, 1e-300))
        for p in range(3):
            room.trial[p] = min(max(position[p] + share * room.trial[p], -1.0), 1.0)
        look(model, room, room.trial)
        cost = best_light(model, room, room.light)
        if cost <= before:
            position[:] = room.trial
            lowered = True
    if not lowered:
        look(model, room, position)
        cost_of(model, room, light)  # the search starts from the present light
        cost = best_light(model, room, room.light)
    if cost <= before:
        light[:] = room.light
    for c in range(len(light)):
        _paint(model, room, c, -light[c])  # where `look` has just been
    return float(min(cost - before, 0.0))


@numba.njit(cache=True)
def refine(model: Any, room: Any, particles: Any, rounds: int) -> float:
    """Fit all particles one after the other, in several rounds.

    Returns the change of the cost.
    """
    total = 0.0
    for _ in range(rounds):
        for n in range(len(particles.position)):
            if particles.alive[n]:
                total += adjust(model, room, particles, n)
    return total


@numba.njit(cache=True)
def start_light(model: Any, room: Any, particles: Any, first: int) -> None:
    """Give particles from a row on the light that those before leave them."""
    for n in range(first, len(particles.position)):
        look(model, room, particles.position[n])
        guess_light(room.signal, room.weight, model.typical, room.logs)
        best_light(model, room, particles.light[n])
        for c in range(len(room.signal)):
            _paint(model, room, c, -particles.light[n, c])


@numba.njit(cache=True)
def put_all_in(model: Any, room: Any, particles: Any) -> None:
    """Subtract all particles from what is left of the images."""
    for n in range(len(particles.position)):
        put_in(model, room, particles.position[n], particles.light[n])


@numba.njit(cache=True)
def price(model: Any, room: Any, position: Any, light: Any) -> float:
    """Compute what a particle must earn to be probable, in units of the cost.

    It is minus the logarithm of the particles expected in the volume that its place is known to,
    and of how much narrower the images make its light than the prior: the better they tell both,
    the less probable it is to find them there by chance.
    """
    room.matrix[:] = 0.0
    for c in range(len(light)):
        sum_up(model, room, c, position)
        for k in range(len(light)):
            room.bend[c, k] = model.precision[c, k]
        room.bend[c, c] += light[c] * light[c] * room.sums[c, _WEIGHT]
        _add_to_matrix(room, c, light[c])
    factorise(room.bend)
    known = 0.5 * (log_determinant(room.bend) - model.log_precision)
    determinant = solve_three(room.matrix, room.right, room.trial)
    known += 0.5 * math.log(max(determinant, 1e-300)) - 1.5 * math.log(2.0 * math.pi)
    return float(known - model.log_rate)


@numba.njit(cache=True)
def add_leverage(model: Any, room: Any, particles: Any, leverage: Any) -> None:
    """Add up how much of each pixel the fit of particles takes for itself.

    In each camera a particle's light takes one pixel's worth altogether, its position as much of
    three as the camera has a share in. Neighbours count as known.
    """
    cameras = len(model.typical)
    for n in range(len(particles.position)):
        for c in range(cameras):
            sum_up(model, room, c, particles.position[n])
            weight, slopes = room.sums[c, _WEIGHT], room.sums[c, _XX] + room.sums[c, _YY]
            if not min(weight, slopes) > _UNSEEN:
                continue
            weights, into = model.weight[c], leverage[c]
            column, row = room.corner[c, 0], room.corner[c, 1]
            rows, columns = weights.shape
            for i in range(max(0, -row), min(len(room.y[c]), rows - row)):
                for j in range(max(0, -column), min(len(room.x[c]), columns - column)):
                    own = room.y[c, i] * room.x[c, j]
                    dx, dy = room.y[c, i] * room.by_x[c, j], room.by_y[c, i] * room.x[c, j]
                    share = own * own / weight + 3.0 / cameras * (dx * dx + dy * dy) / slopes
                    into[row + i, column + j] += share * weights[row + i, column + j]
