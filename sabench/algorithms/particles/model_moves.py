"""Removals of particles that images do not ask for, and sums about cameras.

A ghost shares the light of true particles' images with them. It fits as well as they do, but when
it is taken out, its neighbours fit as well without it. So every particle is taken out for trial,
its neighbours are fitted again, and it comes back only if its absence costs more than its price.
It is a move of P. J. Green, Reversible jump Markov chain Monte Carlo computation and Bayesian model
determination, Biometrika 82, 711-732, 1995, taken where it raises the probability.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sabench.algorithms.particles.image_model import (
    MARGIN,
    PULL,
    SHAPES,
    UNSEEN,
    WEIGHT,
    XX,
    counting,
    fill_image,
    is_plain,
    look,
    place,
    put_in,
    sum_up,
    take_out,
)
from sabench.algorithms.particles.joint_fit import adjust, cost_of, price
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    project_points,
)
from sabench.images.gaussian_kernels import fill_derivatives
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.compiled import numba
from sabench.utils.vector_units import (
    CURVE_X,
    OWN_X,
    OWN_Y,
    SLOPE_X,
    SLOPE_Y,
    TILT_SLOPE_Y,
)

_NEIGHBOURS = 512  # that are fitted again around one particle
_NEAR = 3.6  # widths of images: distance of a neighbour's image in some camera
_SURE = 4.0  # prices that a particle earns which is not tried again
_CERTAIN = 2.0  # prices that it earns alone, without a trial
_SHARED = 0.1  # of a particle's light in a pixel: more from others, and they may take it over


def find_neighbours(maps: VolumePolynomials, sigma: F64, positions: F64) -> tuple[I64, I64]:
    """Find particles whose images are near each other in at least one camera.

    Near is a few widths (camera, 2) of images. Returns where each particle's neighbours start in
    the list (n + 1,), and the list.
    """
    pixels = [project_points(maps, camera, positions) for camera in range(len(sigma))]
    return near_images(np.stack(pixels), _NEAR * sigma.max(axis=1))


@numba.njit(cache=True, nogil=True)
def remove_ghosts(
    model: Any,
    room: Any,
    particles: Any,
    order: Any,
    starts: Any,
    near: Any,
    fits: int,
    lone: bool,
    sure: Any,
    odds: Any,
) -> int:
    """Take particles out for good where the images do not ask for them.

    Returns how many.

    Parameters
    ----------
    order : rows, in the order of the trials.
    starts, near : from `find_neighbours`.
    fits : rounds of fitting the neighbours without a particle.
    lone : whether what a particle earns in the camera where it earns most does not count: light in
        one camera alone is no particle.
    sure : (n,) set for the rows of `order`: whether a particle earns several times its price
        without that camera.
    odds : (n,) set for the same rows: what it earns less its price, the logarithm of the odds that
        it is real; trials end where they are high enough.
    """
    cameras = particles.light.shape[1]
    positions, lights = np.zeros((_NEIGHBOURS, 3)), np.zeros((_NEIGHBOURS, cameras))
    image, removed = np.zeros((room.window, room.window), dtype=np.float32), 0
    for n in order:
        position, light = particles.position[n], particles.light[n]
        least = price(model, room, position, light)
        alone = _earned_alone(model, room, light, image)
        if alone > _CERTAIN * least:
            sure[n], odds[n] = True, alone - least
            continue
        first, last = starts[n], min(starts[n + 1], starts[n] + _NEIGHBOURS)
        neighbours = near[first:last]
        for k in range(len(neighbours)):
            positions[k] = particles.position[neighbours[k]]
            lights[k] = particles.light[neighbours[k]]
        take_out(model, room, position, light)
        look(model, room, position, light)
        loss = -cost_of(model, room, light)
        without_best = least / max(1.0 - _largest_share(room, light), 1e-3)
        if lone:
            least = without_best
        particles.alive[n] = False
        for fit in range(fits):
            if fit and loss > _SURE * without_best:
                break
            for j in neighbours:
                if loss > least and particles.alive[j]:
                    loss += adjust(model, room, particles, j)
        sure[n], odds[n] = loss > _SURE * without_best, loss - least
        if loss <= least:
            removed += 1
            continue
        particles.alive[n] = True
        _put_back(model, room, particles, neighbours, positions, lights)
        put_in(model, room, position, light)
    return removed


@numba.njit(cache=True)
def _put_back(
    model: Any, room: Any, particles: Any, neighbours: Any, positions: Any, lights: Any
) -> None:
    """Put neighbours that are alive back to where they were before a trial."""
    for k in range(len(neighbours)):
        j = neighbours[k]
        if particles.alive[j]:
            take_out(model, room, particles.position[j], particles.light[j])
            particles.position[j], particles.light[j] = positions[k], lights[k]
            put_in(model, room, positions[k], lights[k])


@numba.njit(cache=True)
def _earned_alone(model: Any, room: Any, light: Any, image: Any) -> float:
    """Compute the least that a particle earns, where `price` was just asked for.

    That is in pixels where others leave hardly any light, so that none of them can take over its
    own; without the camera in which this is most, and less the cost of its light's prior.
    """
    most, total, prior = 0.0, 0.0, 0.0
    for c in range(len(light)):
        room.logs[c] = math.log(light[c] / model.typical[c])
    for c in range(len(light)):
        fill_image(model, room, c, image)
        earned = _earned_in(
            model.images[c],
            model.left[c],
            model.weight[c],
            image,
            room.corner[c],
            light[c],
        )
        most, total = max(most, earned), total + max(earned, 0.0)
        for k in range(len(light)):
            prior += 0.5 * room.logs[c] * model.precision[c, k] * room.logs[k]
    return float(total - most - prior)


@numba.njit(cache=True)
def _earned_in(image: Any, left: Any, weights: Any, share: Any, corner: Any, light: float) -> float:
    earned = 0.0
    for i in range(len(share)):
        for j in range(len(share)):
            row, column, own = corner[1] + i, corner[0] + j, light * share[i, j]
            if image[row, column] - left[row, column] - own <= _SHARED * own:
                earned += _saved(weights[row, column], left[row, column], own)
    return earned


@numba.njit(cache=True)
def _saved(weight: Any, left: Any, own: float) -> float:
    """Compute the cost that a particle's light saves in a pixel."""
    without, rest = left + own, left
    if weight < 0.0:  # saturated: light beyond what it shows costs nothing
        weight, without, rest = -weight, max(without, 0.0), max(left, 0.0)
    return float(0.5 * weight * (without * without - rest * rest))


def count_meetings(
    maps: VolumePolynomials, sigma: F64, positions: F64, chosen: Bool, starts: I64, near: I64
) -> I64:
    """Count (n,) in how many cameras, in all, images of chosen ones (n,) are near.

    The neighbours are those of `find_neighbours`.
    """
    pixels = [project_points(maps, camera, positions) for camera in range(len(sigma))]
    counts = np.zeros(len(positions), dtype=np.int64)
    _count_meetings(np.stack(pixels), _NEAR * sigma.max(axis=1), chosen, starts, near, counts)
    return counts


@numba.njit(cache=True)
def _count_meetings(
    pixels: Any, reach: Any, chosen: Any, starts: Any, near: Any, counts: Any
) -> None:
    for n in range(len(counts)):
        for k in near[starts[n] : starts[n + 1]]:
            if chosen[k]:
                for c in range(len(pixels)):
                    x, y = pixels[c, n] - pixels[c, k]
                    counts[n] += x * x + y * y <= reach[c] * reach[c]


@numba.njit(cache=True)
def _largest_share(room: Any, light: Any) -> float:
    """Compute the share of a particle's earnings, after `look`, in its best camera."""
    most, total = 0.0, 1e-300
    for c in range(len(light)):
        earned = max(light[c] * (room.signal[c] - 0.5 * light[c] * room.weight[c]), 0.0)
        most, total = max(most, earned), total + earned
    return float(most / total)


@numba.njit(cache=True, nogil=True)
def measure_misfit(model: Any, room: Any, particles: Any, misfit: Any) -> None:
    """Fill in (n,) how far squares left around particles exceed those of noise.

    The unit is the standard deviation of their sum.
    """
    for n in range(len(misfit)):
        squares, count = 0.0, 0
        place(model, room, particles.position[n])
        for c in range(len(model.typical)):
            left, weights, corner = model.left[c], model.weight[c], room.corner[c]
            for i in range(corner[1], corner[1] + room.window):
                for j in range(corner[0], corner[0] + room.window):
                    each = counting(weights[i, j], left[i, j])
                    squares += each * left[i, j] ** 2
                    count += each > 0.0
        misfit[n] = (squares - count) / math.sqrt(2.0 * count) if count else 0.0


@numba.njit(cache=True, nogil=True)
def measure_earnings(model: Any, room: Any, particles: Any, earned: Any) -> None:
    """Fill in (n, camera) how much cost a particle's light saves in each camera.

    It is negative where a camera does not show the particle.
    """
    for n in range(len(earned)):
        sum_up(model, room, particles.position[n], particles.light[n])
        for c in range(len(model.typical)):
            light = particles.light[n, c]
            earned[n, c] = light * (room.sums[c, PULL] + 0.5 * light * room.sums[c, WEIGHT])


@numba.njit(cache=True, nogil=True)
def add_camera_misses(model: Any, room: Any, particles: Any, equations: Any) -> None:
    """Add up (camera, 5) what each camera alone says of a common shift of its images.

    The columns are the sums xx, xy, yy of the normal equations, and their right sides x and y.
    """
    for n in range(len(particles.position)):
        sum_up(model, room, particles.position[n], particles.light[n])
        for c in range(len(model.typical)):
            light = particles.light[n, c]
            for k in range(3):
                equations[c, k] += light * light * room.sums[c, XX + k]
            for k in range(3, 5):
                equations[c, k] += light * room.sums[c, XX + k]


@numba.njit(cache=True)
def add_shape_misses(
    model: Any, room: Any, particles: Any, rows: Any, matrices: Any, right: Any
) -> None:
    """Add up what some particles say of images' shapes, with light as it fits best.

    The unknowns of a camera are those of `ImageModel.shapes`.

    Parameters
    ----------
    rows : (k,) particles.
    matrices, right : (camera, 4 SHAPES, 4 SHAPES) and (camera, 4 SHAPES) normal equations.
    """
    (own, slopes), both, terms = np.zeros((2, SHAPES)), np.zeros((SHAPES, SHAPES)), np.ones(4)
    image = np.zeros((room.window, room.window), dtype=np.float32)
    changes = np.zeros((SHAPES, room.window, room.window), dtype=np.float32)
    for n in rows:
        terms[1:] = particles.position[n]
        place(model, room, particles.position[n])
        for c in range(len(model.typical)):
            column, row = room.corner[c, 0], room.corner[c, 1]
            fill_image(model, room, c, image)
            _fill_changes(model, room, c, changes)
            left, weights, light = model.left[c], model.weight[c], particles.light[n, c]
            own[:], both[:], slopes[:], whole, pull = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(room.window):
                for j in range(room.window):
                    each = counting(weights[row + i, column + j], left[row + i, column + j])
                    share, off = image[i, j], each * left[row + i, column + j]
                    whole, pull = whole + each * share * share, pull + off * share
                    for a in range(SHAPES):
                        own[a] += each * share * changes[a, i, j]
                        slopes[a] += off * changes[a, i, j]
                        for b in range(SHAPES):
                            both[a, b] += each * changes[a, i, j] * changes[b, i, j]
            if not whole > UNSEEN:
                continue
            for k in range(4 * SHAPES):
                a, p = k // 4, k % 4
                right[c, k] += light * terms[p] * (slopes[a] - own[a] * pull / whole)
                for m in range(4 * SHAPES):
                    b, q = m // 4, m % 4
                    matrices[c, k, m] += (
                        light * light * terms[p] * terms[q] * (both[a, b] - own[a] * own[b] / whole)
                    )


@numba.njit(cache=True)
def _fill_changes(model: Any, room: Any, c: int, changes: Any) -> None:
    """Fill in (shape, row, column) an image's derivatives by its shape.

    They are a plain image's, near enough to step along. A Gaussian's derivative by its
    width is the second by its centre, times the width.
    """
    own, width = room.profiles[c], room.width[c]
    higher, first = np.zeros((2, 4, room.window)), room.corner[c] - MARGIN
    for k in range(2):
        fill_derivatives(room.here[c, k], width[k], first[k], higher[k])
    across, down, plain = width[0] * width[0], width[1] * width[1], is_plain(model.shapes, c)
    for i in range(room.window):
        y, y2, y4 = own[OWN_Y, i], down * higher[1, 0, i], down * down * higher[1, 2, i]
        for j in range(room.window):
            x, x2, x4 = own[OWN_X, j], across * higher[0, 0, j], across * across * higher[0, 2, j]
            changes[0, i, j], changes[1, i, j] = x2 * y / width[0], x * y2 / width[1]
            changes[2, i, j] = own[SLOPE_Y, i] * own[SLOPE_X, j]
            if not plain:
                changes[2, i, j] += own[TILT_SLOPE_Y, i] * own[CURVE_X, j]
            changes[3, i, j] = -(x4 * y + 2.0 * x2 * y2 + x * y4)
