"""Leverage: how much of each pixel the fit of particles takes for itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.algorithms.particles.image_model import (
    UNSEEN,
    WEIGHT,
    XX,
    YY,
    fill_image,
    fill_slopes,
    place,
    sum_up,
)
from sabench.algorithms.particles.light_prior import factorise, fill_inverse_diagonal
from sabench.utils.compiled import numba


@numba.njit(cache=True, nogil=True)
def tell_taken(model: Any, room: Any, particles: Any, taken: Any) -> None:
    """Fill in what the fit of particles takes of each camera's pixels (n, camera, 2).

    The first is the factor of the image's square: the light takes as much of one pixel as the image
    tells more of it than its prior and the other cameras. The second is that of the squares of the
    image's derivatives: the position takes as much of three as the camera has a share in. Both are
    0 where a camera does not see the particle. Neighbours count as known.
    """
    cameras = len(model.typical)
    for n in range(len(particles.position)):
        sum_up(model, room, particles.position[n], particles.light[n])
        room.bend[:] = model.precision
        for c in range(cameras):
            room.bend[c, c] += particles.light[n, c] ** 2 * room.sums[c, WEIGHT]
        factorise(room.bend)
        fill_inverse_diagonal(room.bend, room.pull, room.logs)
        for c in range(cameras):
            weight, slopes = room.sums[c, WEIGHT], room.sums[c, XX] + room.sums[c, YY]
            taken[n, c] = 0.0
            if min(weight, slopes) > UNSEEN:
                taken[n, c, 0] = room.pull[c] * particles.light[n, c] ** 2
                taken[n, c, 1] = 3.0 / cameras / slopes


@numba.njit(cache=True, nogil=True)
def add_leverage(model: Any, room: Any, particles: Any, taken: Any, leverage: Any) -> None:
    """Add up what particles take of each pixel of the model's one camera.

    Taken (n, 2) is its column of `tell_taken`. Leverage has margins.
    """
    own, by_x, by_y = np.zeros((3, room.window, room.window), dtype=np.float32)
    weights, corner = model.weight[0], room.corner[0]
    for n in range(len(particles.position)):
        if not taken[n, 1] > 0.0:
            continue
        place(model, room, particles.position[n])
        fill_image(model, room, 0, own)
        fill_slopes(model, room, 0, by_x, by_y)
        for i in range(room.window):
            for j in range(room.window):
                slopes = by_x[i, j] * by_x[i, j] + by_y[i, j] * by_y[i, j]
                share = taken[n, 0] * own[i, j] * own[i, j] + taken[n, 1] * slopes
                row, column = corner[1] + i, corner[0] + j
                leverage[row, column] += share * abs(weights[row, column])
