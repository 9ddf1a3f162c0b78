"""Splits of particles that make them more probable.

Two particles closer than two pixels look like one. Whether one is two is first asked of what is
left of the images, by the score test of C. R. Rao (Proc. Camb. Phil. Soc. 44, 50-57, 1948): halves
that move apart by s change an image by half its second derivative along s, and how well that
matches what is left tells what a split would gain. Only where it promises enough are two particles
fitted. The split is a move of P. J. Green, Biometrika 82, 711-732, 1995, taken where it raises the
probability.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sabench.algorithms.particles.image_model import (
    MARGIN,
    UNSEEN,
    counting,
    fill_image,
    look,
    place,
    put_in,
    take_out,
)
from sabench.algorithms.particles.joint_fit import adjust, cost_of, price
from sabench.geometry.volume_polynomials import project_point
from sabench.images.gaussian_kernels import fill_bend
from sabench.utils.compiled import numba
from sabench.utils.vector_units import OWN_X, OWN_Y, SLOPE_X, SLOPE_Y

_SAME = 0.8  # widths: distance of images of the two of a split that are one
_SETTLE = 6  # fits of the two particles of a split
_DOUBTFUL = 2  # of them, after which a split that does not pay is given up


@numba.njit(cache=True, nogil=True)
def measure_split_gains(model: Any, room: Any, particles: Any, steps: Any, gains: Any) -> None:
    """Fill in (n,) how much cost a split promises to save.

    It is that along the best of some steps (k, 3). Light is free in each camera, or a peak that is
    lower than the model's would promise as much.
    """
    cameras, size = len(model.typical), room.window
    bent, pull, square = np.zeros((2, size)), np.zeros((cameras, 3)), np.zeros((cameras, 3, 3))
    image = np.zeros((size, size), dtype=np.float32)
    for n in range(len(gains)):
        place(model, room, particles.position[n])
        for c in range(cameras):
            for k in range(2):
                first = room.corner[c, k] - MARGIN
                fill_bend(room.here[c, k], room.width[c, k], first, bent[k])
            _match_bends(model, room, c, bent, image, pull[c], square[c])
        gains[n] = 0.0
        for s in range(len(steps)):
            gain = _promise(room, particles.light[n], steps[s], pull, square)
            gains[n] = max(gains[n], gain)


@numba.njit(cache=True)
def _match_bends(
    model: Any, room: Any, c: int, bent: Any, image: Any, pull: Any, square: Any
) -> None:
    """Match second derivatives of a particle's image in a camera with what is left.

    Fills in their sums (3,) and products (3, 3), by columns, by both, and by rows, less what free
    light explains. Those of the profiles are `bent` (2, pixel); there is room for an image.
    """
    left, weights, bends, shares = model.left[c], model.weight[c], np.zeros(3), np.zeros(3)
    column, row, whole, rest = room.corner[c, 0], room.corner[c, 1], 0.0, 0.0
    by_x, by_y = room.profiles[c, SLOPE_X], room.profiles[c, SLOPE_Y]
    x, y = room.profiles[c, OWN_X], room.profiles[c, OWN_Y]
    fill_image(model, room, c, image)
    pull[:], square[:] = 0.0, 0.0
    for i in range(room.window):
        for j in range(room.window):
            off = left[row + i, column + j]
            each = counting(weights[row + i, column + j], off)
            own = image[i, j]
            bends[0], bends[2] = y[i] * bent[0, j], bent[1, i] * x[j]
            bends[1] = by_y[i] * by_x[j]
            whole, rest = whole + each * own * own, rest + each * off * own
            for k in range(3):
                pull[k] += each * off * bends[k]
                shares[k] += each * own * bends[k]
                for m in range(k + 1):
                    square[k, m] += each * bends[k] * bends[m]
    for k in range(3):
        share = shares[k] / whole if whole > UNSEEN else 0.0
        pull[k] -= share * rest
        for m in range(k + 1):
            square[k, m] -= share * shares[m]
            square[m, k] = square[k, m]


@numba.njit(cache=True)
def _promise(room: Any, light: Any, step: Any, pull: Any, square: Any) -> float:
    """Compute how much cost halves save that move a step (3,) apart.

    To the second order of the step.
    """
    slope, bend, terms = 0.0, 0.0, np.zeros(3)
    for c in range(len(light)):
        x, y = 0.0, 0.0
        for p in range(3):
            x, y = x + room.slope[c, 0, p] * step[p], y + room.slope[c, 1, p] * step[p]
        terms[0], terms[1], terms[2] = 0.5 * x * x, x * y, 0.5 * y * y
        for k in range(3):
            slope += light[c] * terms[k] * pull[c, k]
            for m in range(3):
                bend += light[c] * light[c] * terms[k] * terms[m] * square[c, k, m]
    return 0.5 * slope * slope / bend if slope > 0.0 and bend > 0.0 else 0.0


@numba.njit(cache=True, nogil=True)
def split_pairs(model: Any, room: Any, particles: Any, order: Any, spare: Any, steps: Any) -> None:
    """Replace particles by two each where that is more probable.

    Parameters
    ----------
    order : rows, in the order of the trials.
    spare : (n,) the row that is free for the second of two, for the rows of `order`.
    steps : (k, 3) half distances of the two, in the box's coordinates, that are tried.
    """
    cameras = particles.light.shape[1]
    place, own, places, lights = (
        np.zeros(3),
        np.zeros(cameras),
        np.zeros((2, 3)),
        np.zeros((2, cameras)),
    )
    for n in order:
        count = spare[n]
        place[:], own[:] = particles.position[n], particles.light[n]
        best = 0.0
        for s in range(len(steps)):
            cost = _try_split(model, room, particles, n, count, steps[s])
            if cost < best:
                best = cost
                places[0], places[1] = particles.position[n], particles.position[count]
                lights[0], lights[1] = particles.light[n], particles.light[count]
            take_out(model, room, particles.position[n], particles.light[n])
            take_out(model, room, particles.position[count], particles.light[count])
            particles.position[n], particles.light[n] = place, own
            put_in(model, room, place, own)
        if best < 0.0 and _are_apart(model, room, places):
            take_out(model, room, place, own)
            for k in range(2):
                put_in(model, room, places[k], lights[k])
            dearer = max(
                price(model, room, places[0], lights[0]), price(model, room, places[1], lights[1])
            )
            if best + dearer < 0.0:
                particles.position[n], particles.light[n] = places[0], lights[0]
                particles.position[count], particles.light[count] = places[1], lights[1]
                particles.alive[count] = True
            else:
                for k in range(2):
                    take_out(model, room, places[k], lights[k])
                put_in(model, room, place, own)


@numba.njit(cache=True)
def _are_apart(model: Any, room: Any, places: Any) -> bool:
    """Say whether some camera sees two positions apart.

    If not, one particle with a wider image than others looks the same, and is more probable.
    """
    here, slopes = np.zeros((2, 2)), np.zeros((2, 3))
    for c in range(len(model.typical)):
        for k in range(2):
            project_point(model.maps, c, places[k], here[k], slopes)
        apart = math.hypot(here[0, 0] - here[1, 0], here[0, 1] - here[1, 1])
        if apart > _SAME * max(model.shapes[c, 0, 0], model.shapes[c, 1, 0]):
            return True
    return False


@numba.njit(cache=True)
def _try_split(model: Any, room: Any, particles: Any, n: int, new: int, step: Any) -> float:
    """Replace a particle by two of half its light, and fit both.

    Returns the change of the cost.
    """
    take_out(model, room, particles.position[n], particles.light[n])
    look(model, room, particles.position[n], particles.light[n])
    cost = -cost_of(model, room, particles.light[n])
    for p in range(3):
        middle = particles.position[n, p]
        particles.position[n, p] = min(max(middle + step[p], -1.0), 1.0)
        particles.position[new, p] = min(max(middle - step[p], -1.0), 1.0)
    for c in range(len(model.typical)):
        particles.light[n, c] *= 0.5
        particles.light[new, c] = particles.light[n, c]
    for k in (n, new):
        look(model, room, particles.position[k], particles.light[k])
        cost += cost_of(model, room, particles.light[k])
        put_in(model, room, particles.position[k], particles.light[k])
    for fit in range(_SETTLE):
        cost += adjust(model, room, particles, n)
        cost += adjust(model, room, particles, new)
        if fit == _DOUBTFUL and cost > 0.0:
            break
    return float(cost)
