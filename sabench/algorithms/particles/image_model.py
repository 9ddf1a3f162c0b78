"""Images as sums of particles' images, and the sums over one particle's windows.

All cameras' windows of a particle are placed first, and then looked at, so that kernels pass few
arrays to each other: a call that passes the whole model and room takes longer than a window's sums.

Sums over windows are taken on vector units (`vector_units`): images have margins that windows
outside lie in, rows of a window are a whole number of lanes, and what must not count is multiplied
by zero.
"""

import math
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from sabench.geometry.volume_polynomials import VolumePolynomials, project_point
from sabench.images.gaussian_kernels import fill_derivatives, fill_profile
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.vector_units import (
    LANES,
    Profile,
    match_shaped,
    match_window,
    sum_shaped,
    sum_window,
    whole_lanes,
)

_REACH, _ROUNDED_PX = 3.1, 0.1  # of a particle's image in widths; that much less is enough
MARGIN_PX = 24  # pixels around images: the widest window
UNSEEN = 1e-12  # weight of an image that a camera does not see
SHAPES = 4  # of `ImageModel.shapes`: two widths, covariance, and flatness
TERMS = 5  # of each, over the box: 1, its three coordinates, and the square of the last
MOST_FLAT = 0.07  # a disc of four widths' diameter; edges of flatter ones would be negative
_ANY_ORDER = {"reassoc", "contract", "nsz"}  # of sums


class Sum(IntEnum):
    """Places of the sums of `sum_up`."""

    WEIGHT, PULL, XX, XY, YY, X, Y, GIVEN = range(8)


def with_margins(images: F32) -> F32:
    """Copy images (camera, row, column) into frames of zeros."""
    return np.pad(images, ((0, 0), (MARGIN_PX, MARGIN_PX), (MARGIN_PX, MARGIN_PX)))


def without_margins(images: Any) -> Any:
    """Return the images within their frames: a view, of a camera or all."""
    return images[..., MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]


class ImageModel(NamedTuple):
    """Images as sums of particles' images, and what is left of them.

    Attributes
    ----------
    maps : cameras.
    shapes : (camera, SHAPES, TERMS) of particle images: widths along columns and rows, px,
        covariance of both, px2, and flatness. Their terms are values in the box's middle, changes
        along its coordinates, and with the square of the depth, as out of focus. The last two
        shapes are 0 in the middle for a camera with plain images: Gaussians that have columns and
        rows as axes. Flat ones are like discs.
    typical : (camera,) a typical particle's light.
    precision : (camera, camera) inverse covariance of the logarithms of light.
    log_precision : logarithm of its determinant.
    images : (camera, row, column) float32, less black, with margins.
    weight : the same shape, 1 / variance of a pixel; 0 in margins and where it is unknown, and less
        than 0 where it is saturated: such a pixel may have that much light or more.
    left : the same shape, the images less all particles; kept up to date.
    log_rate : logarithm of the number of particles in a unit cube of the box's coordinates.
    """

    maps: VolumePolynomials
    shapes: F64
    typical: F64
    precision: F64
    log_precision: float
    images: F32
    weight: F32
    left: F32
    log_rate: float


@inner_kernel()
def copy_row(source: Any, target: Any) -> None:
    """Copy numbers (n,): assigning a part of an array takes two seconds to compile."""
    for k in range(len(target)):
        target[k] = source[k]


class ModelParticles(NamedTuple):
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
    window : pixels along columns and rows of windows, an odd number.
    profiles : (camera, profile, lane), as `vector_units` names them, of the image along columns and
        rows, for light 1; zeros after the window's end.
    corner : (camera, 2) first column and row in images with margins; in these for windows outside.
    here, width : (camera, 2) centre in images without margins, and widths, px.
    slope : (camera, 2, 3) derivatives of the centre by the position in the box.
    sums : (camera, sum) of `sum_up`.
    signal, weight : (camera,) of `look`: minus the cost of light L in a camera, relative to no
        light, is L signal - L^2 weight / 2, and `given` in all cameras.
    given : (1,) what light saves in saturated pixels that have enough of it.
    """

    window: int
    profiles: F32
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
        window=window,
        profiles=np.zeros((cameras, len(Profile), whole_lanes(window)), dtype=np.float32),
        corner=np.zeros((cameras, 2), dtype=np.int64),
        slope=np.zeros((cameras, 2, 3)),
        here=np.zeros((cameras, 2)),
        width=np.zeros((cameras, 2)),
        sums=np.zeros((cameras, len(Sum))),
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


@numba.njit(cache=True, inline="always")
def shape_at(terms: Any, position: Any) -> Any:
    """Return a number of an image's shape at a position in the box."""
    x, y, z = position[0], position[1], position[2]
    return terms[0] + terms[1] * x + terms[2] * y + (terms[3] + terms[4] * z) * z


@inner_kernel()
def place_windows(model: Any, room: Any, position: Any) -> None:
    """Place a particle's windows in all cameras, with its images' profiles."""
    half, lanes = room.window // 2, room.profiles.shape[2]
    for c in range(len(room.here)):
        project_point(model.maps, c, position, room.here[c], room.slope[c])
        for k in range(2):
            width = shape_at(model.shapes[c, k], position)
            room.width[c, k] = width
            first = math.floor(room.here[c, k] + 0.5) - half
            last = model.left.shape[2 - k] - lanes
            room.corner[c, k] = min(max(first + MARGIN_PX, 0), last)
            profile, slope = (
                (Profile.OWN_X, Profile.SLOPE_X) if k == 0 else (Profile.OWN_Y, Profile.SLOPE_Y)
            )
            shares, slopes = room.profiles[c, profile], room.profiles[c, slope]
            fill_profile(room.here[c, k], width, first, room.window, shares, slopes)
        if not is_plain(model.shapes, c):
            placement = room.here[c], room.width[c], room.corner[c]
            profiles = room.profiles[c, :, : room.window]
            _shape_profiles(profiles, model.shapes[c], position, *placement)


@numba.njit(cache=True, inline="always")
def is_plain(shapes: Any, c: int) -> bool:
    """Return whether a camera's images are Gaussians with columns and rows as axes."""
    return bool((shapes[c, 2, 0] == 0.0) & (shapes[c, 3, 0] == 0.0))  # `and` is slower


@inner_kernel()
def _shape_profiles(
    table: Any, shape: Any, position: Any, here: Any, width: Any, corner: Any
) -> None:
    """Fill in the profiles (profile, pixel) of a camera's image that is not plain.

    A Gaussian of covariance t of columns and rows is the sum over n of t^n / n! times the product
    of both profiles' derivatives of order n (F. G. Mehler, J. reine angew. Math. 66, 161-176,
    1866), here up to two: within 1 % of the peak for a correlation of 0.3. Images with a flat top
    differ from Gaussians by the fourth derivatives first (F. Y. Edgeworth, Trans. Camb. Phil. Soc.
    20, 36-65 and 113-141, 1905): by the square of the Laplace operator in units of widths, times
    minus the flatness.
    """
    tilt, flat = shape_at(shape[2], position), shape_at(shape[3], position)
    across, down, flat = width[0] * width[0], width[1] * width[1], min(max(flat, 0.0), MOST_FLAT)
    bend = 0.5 * tilt * tilt - 2.0 * flat * across * down
    column, row = -flat * across * across, -flat * down * down
    for k in range(2):
        # rows that have room for four derivatives
        start = Profile.CURVE_X if k == 0 else Profile.WHOLE_Y
        fill_derivatives(here[k], width[k], corner[k] - MARGIN_PX, table[start : start + 4])
    for i in range(table.shape[1]):
        table[Profile.FLAT_X, i] = column * table[Profile.CURVE_X + 2, i]
        table[Profile.FLAT_SLOPE_X, i] = column * table[Profile.CURVE_X + 3, i]
        second, third = table[Profile.WHOLE_Y, i], table[Profile.WHOLE_Y + 1, i]
        fourth, fifth = table[Profile.WHOLE_Y + 2, i], table[Profile.WHOLE_Y + 3, i]
        table[Profile.WHOLE_Y, i] = table[Profile.OWN_Y, i] + row * fourth
        table[Profile.WHOLE_SLOPE_Y, i] = table[Profile.SLOPE_Y, i] + row * fifth
        table[Profile.TILT_Y, i] = tilt * table[Profile.SLOPE_Y, i]
        table[Profile.TILT_SLOPE_Y, i] = tilt * second
        table[Profile.CURVE_Y, i], table[Profile.CURVE_SLOPE_Y, i] = bend * second, bend * third


@numba.njit(cache=True, inline="always")
def _products(shapes: Any, c: int) -> Any:
    """Return an image's first profile across, and its number of products."""
    return (Profile.OWN_X, 1) if is_plain(shapes, c) else (Profile.FLAT_X, 4)


@inner_kernel()
def fill_image(model: Any, room: Any, c: int, image: Any) -> None:
    """Fill in a camera's image (row, column), for light 1, after `place_windows`."""
    (first, count), rows = _products(model.shapes, c), room.profiles[c]
    for i in range(room.window):
        for j in range(room.window):
            image[i, j] = 0.0
            for k in range(count):
                image[i, j] += rows[first + k, j] * rows[Profile.OWN_Y + k, i]


# The indices of the windows' sums are unsigned: a signed one is compared with zero each time.


@inner_kernel()
def counting(weight: Any, left: Any) -> Any:
    """Return the weight of a pixel with what is left there; 0 if it has enough light."""
    none = np.float32(0.0)
    return abs(weight) if (weight >= none) | (left > none) else none


@inner_kernel(fastmath=_ANY_ORDER)
def _paint(image: Any, x: Any, y: Any, size: int, corner: Any, amount: float) -> None:
    top, start = np.uintp(corner[1]), np.uintp(corner[0])
    for block in range(len(x) // LANES):
        first = np.uintp(block * LANES)
        for k in range(size):
            i = np.uintp(k)
            share = np.float32(amount * y[i])
            for lane in range(LANES):
                j = first + np.uintp(lane)
                image[top + i, start + j] += share * x[j]


@inner_kernel()
def paint_here(model: Any, room: Any, light: Any, sign: float) -> None:
    """Add light (camera,) times a sign to the images, where `place_windows` was last."""
    for c in range(len(light)):
        rows, image, amount = room.profiles[c], model.left[c], sign * light[c]
        first, count = _products(model.shapes, c)
        for k in range(count):
            x, y = rows[first + k], rows[Profile.OWN_Y + k]
            _paint(image, x, y, room.window, room.corner[c], amount)


@inner_kernel()
def take_out(model: Any, room: Any, position: Any, light: Any) -> None:
    """Give the light of a particle back to what is left of the images."""
    place_windows(model, room, position)
    paint_here(model, room, light, 1.0)


@inner_kernel()
def put_in(model: Any, room: Any, position: Any, light: Any) -> None:
    """Subtract the light of a particle from what is left of the images."""
    place_windows(model, room, position)
    paint_here(model, room, light, -1.0)


@numba.njit(cache=True, nogil=True)
def paint_all(model: Any, room: Any, particles: Any, sign: float) -> None:
    """Add the light of all particles times a sign to what is left of the images."""
    for n in range(len(particles.position)):
        place_windows(model, room, particles.position[n])
        paint_here(model, room, particles.light[n], sign)


@inner_kernel()
def look(model: Any, room: Any, position: Any, light: Any) -> None:
    """Sum over the windows of a particle of this light at a position.

    The images are those less all other particles.
    """
    place_windows(model, room, position)
    match_here(model, room, light)


@numba.njit(inline="always")
def match_here(model: Any, room: Any, light: Any) -> None:
    """Sum up as `look` does, where `place_windows` was last."""
    room.given[0] = 0.0
    for c in range(len(room.signal)):
        left, weights, row, column = model.left, model.weight, room.corner[c, 1], room.corner[c, 0]
        if is_plain(model.shapes, c):
            signal, weight, given = match_window(
                left, weights, room.profiles, c, row, column, room.window, light[c]
            )
        else:
            signal, weight, given = match_shaped(
                left, weights, room.profiles, c, row, column, room.window, light[c]
            )
        shown = weight > UNSEEN
        room.signal[c], room.weight[c] = signal if shown else 0.0, weight if shown else 0.0
        room.given[0] += given


@inner_kernel()
def sum_up(model: Any, room: Any, position: Any, light: Any) -> None:
    """Fill in all cameras' sums of weights for light 1 of a subtracted particle.

    Squares of its image, products with what is left, squares of the image's derivatives (three),
    their products with what is left (two), and what its light (camera,) saves in saturated pixels
    that have enough with it. The first two and the last are those of `look` without the particle.
    """
    place_windows(model, room, position)
    room.given[0] = 0.0
    for c in range(len(room.sums)):
        left, weights, row, column = model.left, model.weight, room.corner[c, 1], room.corner[c, 0]
        if is_plain(model.shapes, c):
            sums = sum_window(left, weights, room.profiles, c, row, column, room.window, light[c])
        else:
            sums = sum_shaped(left, weights, room.profiles, c, row, column, room.window, light[c])
        for k in range(room.sums.shape[1]):
            room.sums[c, k] = sums[k]
        weight, pull = room.sums[c, Sum.WEIGHT], room.sums[c, Sum.PULL]
        room.weight[c] = weight if weight > UNSEEN else 0.0
        room.signal[c] = pull + light[c] * weight if weight > UNSEEN else 0.0
        room.given[0] += room.sums[c, Sum.GIVEN]
