"""Moves of particles that make a model more probable: removals and splits.

A ghost shares the light of true particles' images with them. It fits as well as they do, but when
it is taken out, its neighbours fit as well without it. So every particle is taken out for trial,
its neighbours are fitted again, and it comes back only if the cost rises by more than its penalty.

Two particles closer than two pixels look like one. Whether one is two is first tested on what is
left of the images, by the score test of C. R. Rao (Proc. Camb. Phil. Soc. 44, 50-57, 1948): halves
that move apart by s change an image by half its second derivative along s, and how well that
matches what is left gives what a split would gain. Two particles are fitted only where this is
enough.

Both are moves of P. J. Green, Reversible jump Markov chain Monte Carlo computation and Bayesian
model determination, Biometrika 82, 711-732, 1995, taken where they raise the probability.
"""

import math
from typing import Any

import numpy as np

from sabench.algorithms.particles.image_model import (
    MARGIN_PX,
    UNSEEN,
    Sum,
    copy_row,
    counting,
    fill_image,
    look,
    place_windows,
    put_in,
    sum_up,
    take_out,
)
from sabench.algorithms.particles.joint_fit import cost_of, fit_particle, penalty
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point, project_points
from sabench.images.gaussian_kernels import fill_bend
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.vector_units import Profile

# Removals:
NEAR = 3.6  # widths of images: distance of those that overlap
_SURE = 4.0  # times its penalty: a particle that gains so much is not tried again

# Splits:
_SAME = 0.8  # widths: distance of images of the two of a split that are one
_SETTLE = 6  # fits of the two particles of a split


def find_neighbours(maps: VolumePolynomials, sigma: F64, positions: F64) -> tuple[I64, I64]:
    """List, as `near_images`, particles a few widths (camera, 2) apart in a camera."""
    pixels = [project_points(maps, camera, positions) for camera in range(len(sigma))]
    return near_images(np.stack(pixels), NEAR * sigma.max(axis=1))


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
    """Remove particles that the images do not support.

    Returns how many.

    Parameters
    ----------
    order : rows, in the order of the trials.
    starts, near : from `find_neighbours`.
    fits : rounds of fitting the neighbours without a particle.
    lone : whether what a particle gains in the camera where it gains most does not count: light in
        one camera alone is no particle.
    sure : (n,) set for the rows of `order`: whether a particle gains several times its penalty
        without that camera.
    odds : (n,) set for the same rows: what it gains less its penalty, the logarithm of the odds
        that it is real; trials end where they are high enough.
    """
    cameras, most = particles.light.shape[1], 0
    for n in order:
        most = max(most, starts[n + 1] - starts[n])
    positions, lights = np.zeros((most, 3)), np.zeros((most, cameras))
    removed = 0
    for n in order:
        position, light = particles.position[n], particles.light[n]
        least = penalty(model, room, position, light)
        neighbours = near[starts[n] : starts[n + 1]]
        for k in range(len(neighbours)):
            _keep(particles, neighbours[k], positions[k], lights[k])
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
                    loss += fit_particle(model, room, particles, j)
        sure[n], odds[n] = loss > _SURE * without_best, loss - least
        if loss <= least:
            removed += 1
            continue
        particles.alive[n] = True
        _put_back(model, room, particles, neighbours, positions, lights)
        put_in(model, room, position, light)
    return removed


@inner_kernel()
def _keep(particles: Any, row: int, position: Any, light: Any) -> None:
    copy_row(particles.position[row], position)
    copy_row(particles.light[row], light)


@inner_kernel()
def _put(particles: Any, row: int, position: Any, light: Any) -> None:
    copy_row(position, particles.position[row])
    copy_row(light, particles.light[row])


@inner_kernel()
def _put_back(
    model: Any, room: Any, particles: Any, neighbours: Any, positions: Any, lights: Any
) -> None:
    for k in range(len(neighbours)):
        j = neighbours[k]
        if particles.alive[j]:
            take_out(model, room, particles.position[j], particles.light[j])
            _put(particles, j, positions[k], lights[k])
            put_in(model, room, positions[k], lights[k])


@numba.njit(inline="always")
def _largest_share(room: Any, light: Any) -> float:
    """Compute the share of a particle's gains, after `look`, in its best camera."""
    most, total = 0.0, 1e-300
    for c in range(len(light)):
        gained = max(light[c] * (room.signal[c] - 0.5 * light[c] * room.weight[c]), 0.0)
        most, total = max(most, gained), total + gained
    return float(most / total)


@numba.njit(cache=True, nogil=True)
def measure_light_gains(model: Any, room: Any, particles: Any, gained: Any) -> None:
    """Fill in (n, camera) the gain of light; negative if a camera shows none."""
    for n in range(len(gained)):
        sum_up(model, room, particles.position[n], particles.light[n])
        for c in range(len(model.typical)):
            light = particles.light[n, c]
            gained[n, c] = light * (room.sums[c, Sum.PULL] + 0.5 * light * room.sums[c, Sum.WEIGHT])


@numba.njit(cache=True, nogil=True)
def measure_split_gains(model: Any, room: Any, particles: Any, steps: Any, gains: Any) -> None:
    """Fill in (n,) the predicted gain of the best split along steps (k, 3).

    The light is free.
    """
    cameras, size = len(model.typical), room.window
    bent, pull, square = np.zeros((2, size)), np.zeros((cameras, 3)), np.zeros((cameras, 3, 3))
    image = np.zeros((size, size), dtype=np.float32)
    for n in range(len(gains)):
        place_windows(model, room, particles.position[n])
        for c in range(cameras):
            for k in range(2):
                first = room.corner[c, k] - MARGIN_PX
                fill_bend(room.here[c, k], room.width[c, k], first, bent[k])
            _match_bends(model, room, c, bent, image, pull[c], square[c])
        gains[n] = 0.0
        for s in range(len(steps)):
            gain = _promise(room, particles.light[n], steps[s], pull, square)
            gains[n] = max(gains[n], gain)


@numba.njit(inline="always")
def _match_bends(
    model: Any, room: Any, c: int, bent: Any, image: Any, pull: Any, square: Any
) -> None:
    """Match second derivatives of a particle's image in a camera with what is left.

    Fills in their sums (3,) and products (3, 3), by columns, by both, and by rows, less what free
    light explains. Those of the profiles are `bent` (2, pixel); there is room for an image.
    """
    left, weights, bends, shares = model.left[c], model.weight[c], np.zeros(3), np.zeros(3)
    column, row, whole, rest = room.corner[c, 0], room.corner[c, 1], 0.0, 0.0
    by_x, by_y = room.profiles[c, Profile.SLOPE_X], room.profiles[c, Profile.SLOPE_Y]
    x, y = room.profiles[c, Profile.OWN_X], room.profiles[c, Profile.OWN_Y]
    fill_image(model, room, c, image)
    pull[:], square[:] = 0.0, 0.0
    for i in range(room.window):
        for j in range(room.window):
            off = left[row + i, column + j]
            each = counting(weights[row + i, column + j], off)
            pixel = image[i, j]
            bends[0], bends[2] = y[i] * bent[0, j], bent[1, i] * x[j]
            bends[1] = by_y[i] * by_x[j]
            whole, rest = whole + each * pixel * pixel, rest + each * off * pixel
            for k in range(3):
                pull[k] += each * off * bends[k]
                shares[k] += each * pixel * bends[k]
                for m in range(k + 1):
                    square[k, m] += each * bends[k] * bends[m]
    for k in range(3):
        share = shares[k] / whole if whole > UNSEEN else 0.0
        pull[k] -= share * rest
        for m in range(k + 1):
            square[k, m] -= share * shares[m]
            square[m, k] = square[k, m]


@numba.njit(inline="always")
def _promise(room: Any, light: Any, step: Any, pull: Any, square: Any) -> float:
    """Compute the decrease of the cost by halves a step (3,) apart, to second order."""
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
    middle, light = np.zeros(3), np.zeros(cameras)
    places, lights = np.zeros((2, 3)), np.zeros((2, cameras))
    for n in order:
        count = spare[n]
        _keep(particles, n, middle, light)
        best = 0.0
        for s in range(len(steps)):
            cost = _try_split(model, room, particles, n, count, steps[s])
            if cost < best:
                best = cost
                _keep(particles, n, places[0], lights[0])
                _keep(particles, count, places[1], lights[1])
            take_out(model, room, particles.position[n], particles.light[n])
            take_out(model, room, particles.position[count], particles.light[count])
            _put(particles, n, middle, light)
            put_in(model, room, middle, light)
        if best < 0.0 and _are_apart(model, room, places):
            take_out(model, room, middle, light)
            for k in range(2):
                put_in(model, room, places[k], lights[k])
            first = penalty(model, room, places[0], lights[0])
            second = penalty(model, room, places[1], lights[1])
            if best + max(first, second) < 0.0:
                _put(particles, n, places[0], lights[0])
                _put(particles, count, places[1], lights[1])
                particles.alive[count] = True
            else:
                for k in range(2):
                    take_out(model, room, places[k], lights[k])
                put_in(model, room, middle, light)


@numba.njit(inline="always")
def _are_apart(model: Any, room: Any, places: Any) -> bool:
    """Return whether some camera sees two positions apart.

    If none does, one wide image is likelier.
    """
    here, slopes = np.zeros((2, 2)), np.zeros((2, 3))
    for c in range(len(model.typical)):
        for k in range(2):
            project_point(model.maps, c, places[k], here[k], slopes)
        apart = math.hypot(here[0, 0] - here[1, 0], here[0, 1] - here[1, 1])
        if apart > _SAME * max(model.shapes[c, 0, 0], model.shapes[c, 1, 0]):
            return True
    return False


@numba.njit(inline="always")
def _try_split(model: Any, room: Any, particles: Any, n: int, new: int, step: Any) -> float:
    """Replace a particle by two of half its light, and fit both.

    Return the change of the cost.
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
    for _ in range(_SETTLE):
        cost += fit_particle(model, room, particles, n)
        cost += fit_particle(model, room, particles, new)
    return float(cost)
