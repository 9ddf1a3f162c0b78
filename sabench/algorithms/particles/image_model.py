"""Images as sums of particles' images, and what they say of one particle.

All cameras' windows of a particle are placed first, and then looked at, so that kernels pass few
arrays to each other: a call that hands on the whole model and room costs more than a window's sums.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from sabench.algorithms.particles.light_prior import factorise, fill_inverse_diagonal
from sabench.geometry.volume_polynomials import VolumePolynomials, project_point
from sabench.images.gaussians import fill_profile
from sabench.utils.arrays import F32, F64

_REACH, _ROUNDED_PX = 3.1, 0.1  # of a particle's image in widths; that much less is enough
UNSEEN = 1e-12  # weight of an image that a camera does not see
WEIGHT, PULL, XX, XY, YY, X, Y = range(7)  # of `sum_up`
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
    images : (camera, row, column) float32, less black.
    weight : the same shape, 1 / variance of a pixel; 0 where it is unknown, and less than 0 where
        it is saturated: such a pixel asks for as much light as it has, or more.
    left : the same shape, the images less all particles; kept up to date.
    log_rate : logarithm of the number of particles in a unit cube of the box's coordinates.
    """

    maps: VolumePolynomials
    widths: F64
    typical: F64
    precision: F64
    log_precision: float
    images: F32
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
    """Room to work in: one particle's windows in all cameras, and their sums.

    Attributes
    ----------
    x, y, by_x, by_y : (camera, pixel) profiles of the image along columns and rows, for light 1,
        and their derivatives by the centre. Windows are as many pixels wide and high as the
        profiles are long, an odd number.
    corner, here, width : (camera, 2) first column and row, centre, and widths, px.
    slope : (camera, 2, 3) derivatives of the centre by the position in the box.
    sums : (camera, SUMS) of `sum_up`.
    signal, weight : (camera,) of `look`: minus the cost of light L in a camera, relative to no
        light, is L signal - L^2 weight / 2, and `given` in all cameras.
    given : (1,) what light saves in saturated pixels that have enough of it.
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
    given: F64
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
        here=np.zeros((cameras, 2)),
        width=np.zeros((cameras, 2)),
        sums=np.zeros((cameras, SUMS)),
        signal=np.zeros(cameras),
        weight=np.zeros(cameras),
        given=np.zeros(1),
        logs=np.zeros(cameras),
        pull=np.zeros(cameras),
        bend=np.zeros((cameras, cameras)),
        matrix=np.zeros((3, 3)),
        right=np.zeros(3),
        trial=np.zeros(3),
        light=np.zeros(cameras),
    )


@numba.njit(cache=True)
def place(model: Any, room: Any, position: Any) -> None:
    """Place a particle's windows in all cameras, with its images' profiles."""
    half = room.x.shape[1] // 2
    for c in range(len(room.here)):
        project_point(model.maps, c, position, room.here[c], room.slope[c])
        for k in range(2):
            room.corner[c, k] = math.floor(room.here[c, k] + 0.5) - half
            width = model.widths[c, k, 0]
            for p in range(3):
                width += model.widths[c, k, p + 1] * position[p]
            room.width[c, k] = width
        fill_profile(room.here[c, 0], room.width[c, 0], room.corner[c, 0], room.x[c], room.by_x[c])
        fill_profile(room.here[c, 1], room.width[c, 1], room.corner[c, 1], room.y[c], room.by_y[c])


@numba.njit(cache=True)
def window_within(corner: Any, size: int, shape: Any) -> Any:
    """Return the first and last rows and columns of a window that lie in an image."""
    rows = max(0, -corner[1]), min(size, shape[0] - corner[1])
    columns = max(0, -corner[0]), min(size, shape[1] - corner[0])
    return rows[0], rows[1], columns[0], columns[1]


# The indices of the windows' sums are unsigned: a signed one is compared with zero each time.


@numba.njit(cache=True)
def counting(weight: Any, left: Any) -> float:
    """Return the weight of a pixel with what is left there; 0 if it has enough light."""
    if weight < 0.0:
        return np.float64(-weight) if left > 0.0 else 0.0
    return np.float64(weight)


@numba.njit(cache=True)
def _paint(image: Any, x: Any, y: Any, corner: Any, amount: float) -> None:
    """Add light with a window's profiles to an image."""
    top, bottom, left, right = window_within(corner, len(x), image.shape)
    for i in range(top, bottom):
        row, share = np.uintp(corner[1] + i), amount * y[i]
        for j in range(left, right):
            image[row, np.uintp(corner[0] + j)] += np.float32(share * x[np.uintp(j)])


@numba.njit(cache=True)
def _match(image: Any, weights: Any, x: Any, y: Any, corner: Any, light: float) -> Any:
    """Sum up weights times a window's image times an image, and times its own square.

    Saturated pixels that have enough with this light count in the third sum.
    """
    top, bottom, left, right = window_within(corner, len(x), image.shape)
    signal = weight = given = 0.0
    for i in range(top, bottom):
        row, along, square = np.uintp(corner[1] + i), 0.0, 0.0
        for j in range(left, right):
            column, own = np.uintp(corner[0] + j), x[np.uintp(j)]
            value, each = np.float64(image[row, column]), np.float64(weights[row, column])
            if each < 0.0:
                each = -each
                if value - light * y[i] * own <= 0.0:
                    given += 0.5 * each * max(value, 0.0) ** 2
                    continue
            along += each * own * value
            square += each * own * own
        signal, weight = signal + y[i] * along, weight + y[i] * y[i] * square
    return signal, weight, given


@numba.njit(cache=True)
def _sum_window(
    image: Any, weights: Any, x: Any, y: Any, by_x: Any, by_y: Any, corner: Any, sums: Any
) -> None:
    """Fill in the sums (SUMS,) of a window, first along its rows."""
    top, bottom, left, right = window_within(corner, len(x), image.shape)
    weight = pull = xx = xy = yy = along_x = along_y = 0.0
    for i in range(top, bottom):
        row = np.uintp(corner[1] + i)
        own = both = slopes = off = off_x = 0.0
        for j in range(left, right):
            column, a, b = np.uintp(corner[0] + j), x[np.uintp(j)], by_x[np.uintp(j)]
            each = counting(weights[row, column], image[row, column])
            light = each * image[row, column]
            own, both, slopes = own + each * a * a, both + each * a * b, slopes + each * b * b
            off, off_x = off + light * a, off_x + light * b
        p, q = y[i], by_y[i]
        weight, pull = weight + p * p * own, pull + p * off
        xx, xy, yy = xx + p * p * slopes, xy + p * q * both, yy + q * q * own
        along_x, along_y = along_x + p * off_x, along_y + q * off
    sums[WEIGHT], sums[PULL], sums[XX], sums[XY], sums[YY] = weight, pull, xx, xy, yy
    sums[X], sums[Y] = along_x, along_y


@numba.njit(cache=True)
def paint_here(model: Any, room: Any, light: Any, sign: float) -> None:
    """Add light (camera,) times a sign to the images, where `place` was last."""
    for c in range(len(light)):
        _paint(model.left[c], room.x[c], room.y[c], room.corner[c], sign * light[c])


@numba.njit(cache=True)
def take_out(model: Any, room: Any, position: Any, light: Any) -> None:
    """Give the light of a particle back to what is left of the images."""
    place(model, room, position)
    paint_here(model, room, light, 1.0)


@numba.njit(cache=True)
def put_in(model: Any, room: Any, position: Any, light: Any) -> None:
    """Subtract the light of a particle from what is left of the images."""
    place(model, room, position)
    paint_here(model, room, light, -1.0)


@numba.njit(cache=True)
def put_all_in(model: Any, room: Any, particles: Any) -> None:
    """Subtract all particles from what is left of the images."""
    for n in range(len(particles.position)):
        put_in(model, room, particles.position[n], particles.light[n])


@numba.njit(cache=True)
def look(model: Any, room: Any, position: Any, light: Any) -> None:
    """Sum up what the images less all others say of a particle at a position.

    Light (camera,) tells which saturated pixels have enough.
    """
    place(model, room, position)
    match_here(model, room, light)


@numba.njit(cache=True)
def match_here(model: Any, room: Any, light: Any) -> None:
    """Sum up as `look` does, where `place` was last."""
    room.given[0] = 0.0
    for c in range(len(room.signal)):
        signal, weight, given = _match(
            model.left[c], model.weight[c], room.x[c], room.y[c], room.corner[c], light[c]
        )
        seen = weight > UNSEEN
        room.signal[c], room.weight[c] = signal if seen else 0.0, weight if seen else 0.0
        room.given[0] += given


@numba.njit(cache=True)
def sum_up(model: Any, room: Any, position: Any) -> None:
    """Fill in all cameras' sums of weights, of a particle whose light is subtracted.

    Squares of its image, products with what is left, squares of the image's derivatives (three),
    and their products with what is left (two); all for light 1.
    """
    place(model, room, position)
    for c in range(len(room.sums)):
        _sum_window(
            model.left[c],
            model.weight[c],
            room.x[c],
            room.y[c],
            room.by_x[c],
            room.by_y[c],
            room.corner[c],
            room.sums[c],
        )


@numba.njit(cache=True)
def add_leverage(model: Any, room: Any, particles: Any, leverage: Any) -> None:
    """Add up how much of each pixel the fit of particles takes for itself.

    In each camera a particle's light takes as much of one pixel as the image tells more of it than
    its prior and the other cameras, its position as much of three as the camera has a share in.
    Neighbours count as known.
    """
    cameras = len(model.typical)
    for n in range(len(particles.position)):
        sum_up(model, room, particles.position[n])
        room.bend[:] = model.precision
        for c in range(cameras):
            room.bend[c, c] += particles.light[n, c] ** 2 * room.sums[c, WEIGHT]
        factorise(room.bend)
        fill_inverse_diagonal(room.bend, room.pull, room.logs)
        for c in range(cameras):
            weight, slopes = room.sums[c, WEIGHT], room.sums[c, XX] + room.sums[c, YY]
            if not min(weight, slopes) > UNSEEN:
                continue
            taken = room.pull[c] * particles.light[n, c] ** 2
            x, y, by_x, by_y = room.x[c], room.y[c], room.by_x[c], room.by_y[c]
            weights, into, corner = model.weight[c], leverage[c], room.corner[c]
            top, bottom, left, right = window_within(corner, len(x), weights.shape)
            for i in range(top, bottom):
                for j in range(left, right):
                    own, dx, dy = y[i] * x[j], y[i] * by_x[j], by_y[i] * x[j]
                    share = taken * own * own + 3.0 / cameras * (dx * dx + dy * dy) / slopes
                    row, column = corner[1] + i, corner[0] + j
                    into[row, column] += share * abs(weights[row, column])
