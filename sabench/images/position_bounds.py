"""Cramer-Rao bounds of particles' positions: how exactly the images fix them.

A particle has four unknowns: its position, and one factor of its light in all cameras. Its image in
a camera is a Gaussian, averaged over pixels. Particles whose images overlap share unknowns, so that
each bound is that of a fit in which the neighbours are unknown, too. The neighbours' own
neighbours are taken as known: a bound with fewer unknowns is lower, and so remains a bound.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sabench.images.gaussian_kernels import fill_profile
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores
from sabench.utils.vector_units import add_product, whole_lanes

_REACH = 4.0  # standard deviations from the centre of an image to its window's edge
_OVERLAP = 2.0  # standard deviations of both: distance of images that overlap
_WIDEST = 32  # px: half a window
_UNKNOWNS = 4  # logarithm of the light, and position
# of each unknown's own information: a neighbour's is known by that share before, so that one that
# one camera alone sees makes no matrix singular; least eigenvalue of a particle's
_ROUNDING = float(np.sqrt(np.finfo(float).eps))
_EXACT = 1e-4  # share of a rest that conjugate gradients may still take


@dataclass(frozen=True)
class ParticleSpots:
    """Images of n particles in one camera.

    Attributes
    ----------
    pixel : (n, 2) column, row of the centres; NaN where there is none.
    slope : (n, 2, 3) derivatives of the centre by the position, px/mm.
    light : (n,) integral of the image; 0 where the camera does not see the particle.
    sigma_px : (n,) standard deviation.
    variance : (row, column) of the pixels' noise, in the square of the unit of the light; infinite
        where a pixel tells nothing.
    """

    pixel: F64
    slope: F64
    light: F64
    sigma_px: F64
    variance: F64


def position_bounds(cameras: Sequence[ParticleSpots], rows: I64) -> F64:
    """Compute the least covariances (k, 3, 3) mm2 of some unbiased positions.

    NaN if the images do not fix the position. Source: Cramer-Rao inequality with the Fisher
    information of normal noise of known variance.
    """
    pixels = np.stack([camera.pixel for camera in cameras])
    for pixel, camera in zip(pixels, cameras, strict=True):
        seen = (camera.light > 0.0) & (_REACH * camera.sigma_px + 1.0 < _WIDEST)
        pixel[~seen] = np.nan
    widest = np.array([float(camera.sigma_px.max(initial=0.0)) for camera in cameras])
    starts, near = near_images(pixels, 2.0 * _OVERLAP * widest)
    own = np.zeros((pixels.shape[1], _UNKNOWNS, _UNKNOWNS))
    both = np.zeros((len(near), _UNKNOWNS, _UNKNOWNS))
    for camera, pixel in zip(cameras, pixels, strict=True):
        _add_information(camera, pixel, starts, near, own, both)
    information = np.zeros((len(rows), _UNKNOWNS, _UNKNOWNS))
    known = own + np.eye(_UNKNOWNS) * (_ROUNDING * own + np.finfo(float).tiny)
    inverse = np.linalg.inv(known)
    blocks = own, known, inverse, both
    on_cores(_fill_information, len(rows), starts, near, blocks, rows, information)
    return _covariances(information)


def _covariances(information: F64) -> F64:
    """Invert information (k, 4, 4) to covariances (k, 3, 3); NaN where singular."""
    with np.errstate(invalid="ignore"):
        scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    regular = scale.min(axis=1) > 0.0
    even = np.tile(np.eye(_UNKNOWNS), (len(information), 1, 1))
    scale[~regular] = 1.0
    even[regular] = (information / scale[:, :, None] / scale[:, None, :])[regular]
    regular &= np.linalg.eigvalsh(even)[:, 0] > _ROUNDING
    even[~regular] = np.eye(_UNKNOWNS)
    covariances = (np.linalg.inv(even) / scale[:, :, None] / scale[:, None, :])[:, 1:, 1:]
    covariances[~regular] = np.nan
    return covariances


def _add_information(
    camera: ParticleSpots, pixel: F64, starts: I64, near: I64, own: F64, both: F64
) -> None:
    """Add the Fisher information of a camera's images, and of pairs that overlap.

    Parameters
    ----------
    pixel : (n, 2) of the images that count.
    starts, near : pairs, as `near_images` lists them.
    own, both : (n, 4, 4) and (pair, 4, 4) blocks of logarithm of the light and position.
    """
    count = len(pixel)
    half = np.where(np.isfinite(pixel[:, 0]), np.ceil(_REACH * camera.sigma_px + 0.5), 0)
    half = half.astype(np.int64)
    size = whole_lanes(2 * int(half.max(initial=0)) + 1)
    first = np.zeros((count, 2), dtype=np.int64)
    grey, change = np.zeros((count, 2, size)), np.zeros((count, 2, size))
    _fill_profiles(pixel, camera.sigma_px, half, first, grey, change)
    images = pixel, camera.sigma_px, camera.light, (first, half, grey, change), camera.slope
    on_cores(_add_pairs, count, starts, near, images, 1.0 / camera.variance, own, both)


@numba.njit(cache=True)
def _fill_profiles(
    pixel: Any, sigma: Any, half: Any, first: Any, grey: Any, slope: Any
) -> None:  # pragma: no cover
    """Fill in windows' corners (n, 2), and profiles (n, 2, pixel) for light 1."""
    for i in range(len(pixel)):
        if np.isnan(pixel[i, 0]):
            continue
        for axis in range(2):
            first[i, axis] = int(np.rint(pixel[i, axis])) - half[i]
            profile = grey[i, axis], slope[i, axis]
            fill_profile(pixel[i, axis], sigma[i], first[i, axis], 2 * half[i] + 1, *profile)


@numba.njit(cache=True, nogil=True)
def _add_pairs(
    jobs: slice, starts: Any, near: Any, images: Any, weight: Any, own: Any, both: Any
) -> None:  # pragma: no cover
    """Add the information of some particles' images, and of pairs with later ones."""
    pixel, sigma, light, shapes, slope = images
    inner, block = np.zeros((3, 3)), np.zeros((_UNKNOWNS, _UNKNOWNS))
    for i in range(jobs.start, jobs.stop):
        if np.isnan(pixel[i, 0]):
            continue
        _overlap(i, i, light, shapes, weight, inner)
        _chain(inner, slope[i], slope[i], block)
        _add(block, own[i])
        for place in range(starts[i], starts[i + 1]):
            j = near[place]
            if j < i or np.isnan(pixel[j, 0]):
                continue
            x, y = pixel[i, 0] - pixel[j, 0], pixel[i, 1] - pixel[j, 1]
            if math.hypot(x, y) < _OVERLAP * (sigma[i] + sigma[j]):
                _overlap(i, j, light, shapes, weight, inner)
                _chain(inner, slope[i], slope[j], block)
                _add(block, both[place])
                mirror = starts[j] + np.searchsorted(near[starts[j] : starts[j + 1]], i)
                _add(block.T, both[mirror])


# Kernels have loops where numpy has expressions of arrays: numba would compile the checks of their
# shapes and the messages of these for half a minute.
@inner_kernel()
def _add(block: Any, total: Any) -> None:  # pragma: no cover
    for a in range(_UNKNOWNS):
        for b in range(_UNKNOWNS):
            total[a, b] += block[a, b]


@inner_kernel()
def _chain(inner: Any, one: Any, other: Any, block: Any) -> None:  # pragma: no cover
    """Fill in unknowns' block (4, 4) from derivatives by column, row and light."""
    block[0, 0] = inner[2, 2]
    for p in range(3):
        block[0, 1 + p] = inner[2, 0] * other[0, p] + inner[2, 1] * other[1, p]
        block[1 + p, 0] = one[0, p] * inner[0, 2] + one[1, p] * inner[1, 2]
        column = one[0, p] * inner[0, 0] + one[1, p] * inner[1, 0]
        row = one[0, p] * inner[0, 1] + one[1, p] * inner[1, 1]
        for q in range(3):
            block[1 + p, 1 + q] = column * other[0, q] + row * other[1, q]


@inner_kernel()
def _overlap(
    i: int, j: int, light: Any, shapes: Any, weight: Any, inner: Any
) -> None:  # pragma: no cover
    """Sum products (3, 3) of two images' derivatives by column, row and ln light."""
    first, half, grey, slope = shapes
    rows, columns = weight.shape
    left = max(first[i, 0], first[j, 0], 0)
    right = min(first[i, 0] + 2 * half[i], first[j, 0] + 2 * half[j], columns - 1)
    top = max(first[i, 1], first[j, 1], 0)
    bottom = min(first[i, 1] + 2 * half[i], first[j, 1] + 2 * half[j], rows - 1)
    xx = xy = xl = yx = yy = yl = lx = ly = ll = 0.0
    for row in range(top, bottom + 1):
        p, u = grey[i, 1, row - first[i, 1]], slope[i, 1, row - first[i, 1]]
        q, v = grey[j, 1, row - first[j, 1]], slope[j, 1, row - first[j, 1]]
        both = by_i = by_j = level = 0.0  # sums along the row: slopes, and one's slope alone
        for column in range(left, right + 1):
            a, b = grey[i, 0, column - first[i, 0]], slope[i, 0, column - first[i, 0]]
            c, d = grey[j, 0, column - first[j, 0]], slope[j, 0, column - first[j, 0]]
            each = weight[row, column]
            both, by_i = both + each * b * d, by_i + each * b * c
            by_j, level = by_j + each * a * d, level + each * a * c
        xx, xy, xl = xx + p * q * both, xy + p * v * by_i, xl + p * q * by_i
        yx, yy, yl = yx + u * q * by_j, yy + u * v * level, yl + u * q * level
        lx, ly, ll = lx + p * q * by_j, ly + p * v * level, ll + p * q * level
    power = light[i] * light[j]
    inner[0, 0], inner[0, 1], inner[0, 2] = power * xx, power * xy, power * xl
    inner[1, 0], inner[1, 1], inner[1, 2] = power * yx, power * yy, power * yl
    inner[2, 0], inner[2, 1], inner[2, 2] = power * lx, power * ly, power * ll


@numba.njit(cache=True, nogil=True)
def _fill_information(
    jobs: slice, starts: Any, near: Any, blocks: Any, rows: Any, out: Any
) -> None:  # pragma: no cover
    """Fill in the information of particles whose partners are fitted, too."""
    own, known, inverse, both = blocks
    slot = np.full(len(own), -1)  # of a particle among the partners of the present one
    for k in range(jobs.start, jobs.stop):
        i = rows[k]
        partners = near[starts[i] : starts[i + 1]]
        for n in range(len(partners)):
            slot[partners[n]] = n
        pairs = _among(starts, near, partners, slot)
        for partner in partners:
            slot[partner] = -1
        shared = both[starts[i] : starts[i + 1]]
        _reduce(own[i], shared, partners, known, inverse, pairs, both, out[k])


@numba.njit(inline="always")
def _among(starts: Any, near: Any, partners: Any, slot: Any) -> Any:  # pragma: no cover
    """List pairs among partners: where each one's start, places, and others."""
    most = 0
    for one in partners:
        most += starts[one + 1] - starts[one]
    links, n = np.zeros(len(partners) + 1, dtype=np.int64), 0
    places, ends = np.zeros(most, dtype=np.int64), np.zeros(most, dtype=np.int64)
    for row in range(len(partners)):
        for place in range(starts[partners[row]], starts[partners[row] + 1]):
            other = slot[near[place]]
            if other >= 0:
                places[n], ends[n] = place, other
                n += 1
        links[row + 1] = n
    return links, places, ends


@inner_kernel()
def _reduce(
    own: Any, shared: Any, partners: Any, known: Any, inverse: Any, pairs: Any, both: Any, out: Any
) -> None:  # pragma: no cover
    """Compute a particle's information (4, 4) if its partners are fitted, too.

    That is the Schur complement, by conjugate gradients (M. R. Hestenes and E. Stiefel, J. Res.
    Natl. Bur. Stand. 49, 409-436, 1952) for each unknown, preconditioned by the partners' own
    blocks (partner, 4, 4). Its error is of second order in that of the solutions.
    """
    count, k = len(shared), _UNKNOWNS
    right, left, x = np.zeros((count, k, k)), np.zeros((count, k, k)), np.zeros((count, k, k))
    better, pull, step = np.zeros((count, k, k)), np.zeros((count, k, k)), np.zeros((count, k, k))
    size, bend, after, share, rest = np.zeros(k), np.zeros(k), np.zeros(k), np.zeros(k), np.zeros(k)
    for n in range(count):
        for a in range(k):
            for b in range(k):
                right[n, a, b] = left[n, a, b] = shared[n, b, a]
    _times_blocks(inverse, partners, left, step)
    _fill_product(left, step, size)
    for a in range(k):
        rest[a] = own[a, a]
    for _ in range(count * k):
        _times_blocks(known, partners, step, pull)
        _add_links(pairs, both, step, pull)
        _fill_product(step, pull, bend)
        exact = True
        for a in range(k):
            share[a] = size[a] / bend[a] if bend[a] > 0.0 else 0.0
            rest[a] -= share[a] * size[a]
            exact = exact and share[a] * size[a] < _EXACT * rest[a]
        for n in range(count):
            for a in range(k):
                for b in range(k):
                    x[n, a, b] += share[b] * step[n, a, b]
                    left[n, a, b] -= share[b] * pull[n, a, b]
        if exact:
            break
        _times_blocks(inverse, partners, left, better)
        _fill_product(left, better, after)
        for a in range(k):
            share[a] = after[a] / size[a] if size[a] > 0.0 else 0.0
            size[a] = after[a]
        for n in range(count):
            for a in range(k):
                for b in range(k):
                    step[n, a, b] = better[n, a, b] + share[b] * step[n, a, b]
    for a in range(k):
        for b in range(k):
            out[a, b] = own[a, b]
    for n in range(count):
        for c in range(k):
            for a in range(k):
                for b in range(k):
                    out[a, b] -= right[n, c, a] * x[n, c, b] + x[n, c, a] * left[n, c, b]
    for a in range(k):
        for b in range(a):
            out[a, b] = out[b, a] = 0.5 * (out[a, b] + out[b, a])


@inner_kernel()
def _times_blocks(blocks: Any, rows: Any, vectors: Any, out: Any) -> None:  # pragma: no cover
    """Fill in products of some rows' blocks with vectors."""
    for n in range(len(out)):
        for a in range(_UNKNOWNS):
            for b in range(_UNKNOWNS):
                out[n, a, b] = 0.0
        add_product(out, n, blocks, rows[n], vectors, n)


@numba.njit(inline="always")
def _add_links(pairs: Any, both: Any, vectors: Any, out: Any) -> None:  # pragma: no cover
    """Add products of blocks of pairs with the others' vectors."""
    links, places, ends = pairs
    for n in range(len(out)):
        for link in range(links[n], links[n + 1]):
            add_product(out, n, both, places[link], vectors, ends[link])


@inner_kernel()
def _fill_product(one: Any, other: Any, total: Any) -> None:  # pragma: no cover
    """Fill in the sums (4,) of products, for each unknown."""
    for r in range(_UNKNOWNS):
        total[r] = 0.0
    for n in range(len(one)):
        for a in range(_UNKNOWNS):
            for r in range(_UNKNOWNS):
                total[r] += one[n, a, r] * other[n, a, r]
