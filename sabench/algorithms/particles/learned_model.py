"""Noise, light, shapes and shifts of cameras, learned from a search's particles.

Light and shapes come from particles that stand alone in the images.
"""

import math
from typing import Any

import numpy as np

from sabench.algorithms.particles.all_particles import sum_in_cameras
from sabench.algorithms.particles.image_model import (
    MARGIN_PX,
    MOST_FLAT,
    SHAPES,
    TERMS,
    UNSEEN,
    ModelParticles,
    Sum,
    copy_row,
    counting,
    fill_image,
    is_plain,
    place_windows,
    sum_up,
)
from sabench.algorithms.particles.joint_fit import FARTHEST_PX, OWN_ERROR, learn_covariance
from sabench.algorithms.particles.model_moves import NEAR
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.geometry.volume_polynomials import project_points
from sabench.images.gaussian_kernels import fill_derivatives
from sabench.images.near_images import near_images
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import numba
from sabench.utils.threads import for_each, share_rows
from sabench.utils.vector_units import Profile

FEW = 30  # too few particles to represent all
_STEPS = 2  # of a fit of the cameras' shifts or shapes
_ERROR = 0.2  # of the first widths and tilts, and of tilts over the box: their scatter
_WIDTH_CHANGE = 0.05  # of widths over the box
_TILTED = 0.2  # correlation somewhere in the box that loses particles
_FLAT = 0.01  # flatness: isolated Gaussians show up to 0.005, discs of 2.5 px 0.03
_LONGEST = 0.25  # of these errors: a step; with whole ones, realistic images have more ghosts

# Variance of pixels:
_CLIP = 30.0  # mean squares: largest contribution of a pixel; .005 of F1 of realistic images
_UNKNOWN = 0.25  # of light that is left: other particles' tails do not explain it

# particles for each unknown of a camera's images, and overlap of isolated ones; 30 in all lose
# .015 of F1 at 0.18 particles per pixel; all particles gain .09 there, but let in ghosts where
# light is even, and mirror images
_EACH, _HARDLY = 5, 0.1


def weigh_pixels(search: ParticleSearch, cap: float) -> None:
    """Estimate the variance of every pixel from what is left.

    It is a line over the model's light, fitted to the squares of what is left. The part above the
    variance of dark pixels is at most `cap` of a typical peak squared, but not less than what
    particles leave that are a little wider or narrower than others, or not found yet.
    """
    peaks = search.peaks()

    def weigh(camera: int) -> None:
        image, left, known = search.images[camera], search.left[camera], search.known[camera]
        light = np.clip(image - left, 0.0, np.maximum(image, 0.0))
        # a saturated pixel has enough light
        squares = np.square(np.maximum(left, np.where(search.saturated[camera], 0.0, -np.inf)))
        dark, most = float(search.noise[camera]) ** 2, (cap * float(peaks[camera])) ** 2
        shown, off = light[known].astype(np.float64), squares[known].astype(np.float64)
        even, slope = 0.0, 0.0
        if np.ptp(shown) > 0.0:
            off = np.minimum(off, _CLIP * off.mean())
            bend = np.cov(shown, off)
            slope = bend[0, 1] / bend[0, 0]
            even = off.mean() - slope * shown.mean()
        usual = max(even, dark) + max(slope, 0.0) * light
        least = np.square(OWN_ERROR * light) + _UNKNOWN**2 * squares
        search.variance[camera] = np.maximum(np.minimum(usual, dark + most), dark + least)

    for_each(weigh, len(peaks))


def learn_light(search: ParticleSearch) -> None:
    """Learn typical light and its covariance from the particles that stand alone.

    The most probable lights differ less than the true ones, which noise hides: what cameras have in
    common gets its variance given the images (A. P. Dempster et al., J. R. Stat. Soc. B 39, 1-38,
    1977). With the factor in `learn_covariance` it is worth .015 of recall in suite `particles`,
    case `noise`, where peaks are five times the noise.
    """
    lone = _find_lone(search)
    if len(lone) < FEW:
        return
    light, prior = search.light[lone], search.covariance
    logs = np.log(light / search.typical)
    # variance by noise: a Gaussian's light is fitted over 4 pi sigma_x sigma_y pixels
    errors = 4.0 * np.pi * search.sigma.prod(axis=1) * np.square(search.noise / light)
    both = prior + errors[:, :, None] * np.eye(len(prior))
    search.typical = search.typical * np.exp(np.median(logs, axis=0))
    search.covariance = (
        learn_covariance(logs) + (prior - prior @ np.linalg.inv(both) @ prior).mean()
    )


def learn_widths(search: ParticleSearch) -> None:
    """Learn the shapes of images, and how they change, from isolated particles.

    Few particles must be missing, because what they leave makes others wider.
    """
    lone = _find_lone(search)
    if len(lone) < FEW:
        return
    model, cameras = search.model(), len(search.images)
    particles = ModelParticles(*(each[lone] for each in search.particles()))
    areas = search.sigma.prod(axis=1)
    units = np.column_stack([search.sigma, areas, np.ones(cameras)])[:, :, None]
    widths = [_ERROR, *[_WIDTH_CHANGE] * 3, _ERROR]
    expected = [widths, widths, [_ERROR] * TERMS, [MOST_FLAT] * TERMS]
    errors, unknowns = np.array(expected) * units, SHAPES * TERMS
    for _ in range(_STEPS):
        each = model, search.widest, particles
        sums = sum_in_cameras(add_shape_misses, *each, (unknowns, unknowns + 1))
        matrices, right = sums[:, :, :-1], sums[:, :, -1]
        right -= (errors**-2.0 * (search.shapes - search.first_shapes)).reshape(cameras, -1)
        matrices += (errors**-2.0).reshape(cameras, -1, 1) * np.eye(unknowns)
        _keep_plain(search, matrices, right)
        step = np.linalg.solve(matrices, right[:, :, None]).reshape(search.shapes.shape)
        search.shapes += np.clip(step, -_LONGEST * errors, _LONGEST * errors)
        flat = search.shapes[:, 3]
        np.clip(flat[:, 0], 0.0, MOST_FLAT, out=flat[:, 0])
        flat[flat[:, 0] == 0.0] = 0.0
        search.subtract_all()
    search.sure[:] = False  # two halves of an image of another shape gain nothing now


def _keep_plain(search: ParticleSearch, matrices: F64, right: F64) -> None:
    """Take tilts and flatness out of the equations of images that hardly have any.

    They slow the fits down.
    """
    tilted, flat = (slice(k * TERMS, (k + 1) * TERMS) for k in (2, 3))
    tilts, flatness = (
        np.linalg.solve(matrices[:, out, out], right[:, out, None])[:, :, 0]
        for out in (tilted, flat)
    )
    farthest = np.abs(tilts).sum(axis=1) / search.sigma.prod(axis=1)
    hardly = np.stack([farthest < _TILTED, flatness[:, 0] < _FLAT], axis=1)
    for camera, term in np.argwhere(hardly & (search.shapes[:, 2:, 0] == 0.0)):
        out = (tilted, flat)[term]
        matrices[camera, out], matrices[camera, :, out], right[camera, out] = 0.0, 0.0, 0.0
        matrices[camera, out, out] = np.eye(TERMS)


def align_cameras(search: ParticleSearch) -> None:
    """Shift each camera's pixels to its particles.

    A common shift of all cameras cannot be seen.
    """
    if len(search.position) < FEW:
        return
    for _ in range(_STEPS):
        each = search.model(), search.widest, search.particles()
        sums = sum_in_cameras(add_camera_misses, *each, (5,))
        xx, xy, yy, x, y = sums.T
        matrix = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=2)
        shifts = np.zeros((len(matrix), 2))
        solvable = np.linalg.det(matrix) > 0.0  # cameras that see some particles
        right = np.stack([x, y], axis=1)[solvable, :, None]
        shifts[solvable] = np.linalg.solve(matrix[solvable], right)[:, :, 0]
        search.maps.coefficients[:, 0] += np.clip(shifts, -FARTHEST_PX, FARTHEST_PX)
        search.subtract_all()
        search.refine(1)


def _find_lone(search: ParticleSearch) -> I64:
    """Find particles with complete images that overlap least with others'."""
    maps, position, light, sigma = search.maps, search.position, search.light, search.sigma
    if len(position) < FEW:
        return np.zeros(0, dtype=np.int64)
    pixels = np.stack([project_points(maps, camera, position) for camera in range(len(sigma))])
    reach = NEAR * sigma.max(axis=1)
    border = reach[:, None, None]
    last = np.array(search.images.shape[:0:-1]) - 1.0
    inside = ((pixels > border) & (pixels < last - border)).all(axis=(0, 2))
    starts, near = near_images(pixels, reach)
    overlap = np.zeros(len(position))

    def add(rows: slice) -> None:
        _add_overlap(rows.start, pixels, light, sigma, reach, starts, near, overlap[rows])

    share_rows(add, len(position))
    least = np.sort(np.where(inside, overlap, np.inf))
    most = max(least[min(_EACH * SHAPES * TERMS, len(least) - 1)], _HARDLY * len(sigma))
    return np.flatnonzero(inside & (overlap <= most))


@numba.njit(cache=True, nogil=True)
def _add_overlap(
    first: int,
    pixels: Any,
    light: Any,
    sigma: Any,
    reach: Any,
    starts: Any,
    near: Any,
    overlap: Any,
) -> None:
    """Add up the light of near images over the particles' own, from the first row on."""
    for k in range(len(overlap)):
        n = first + k
        for other in near[starts[n] : starts[n + 1]]:
            for c in range(len(sigma)):
                x = pixels[c, n, 0] - pixels[c, other, 0]
                y = pixels[c, n, 1] - pixels[c, other, 1]
                if x * x + y * y <= reach[c] ** 2:
                    apart = 0.25 * ((x / sigma[c, 0]) ** 2 + (y / sigma[c, 1]) ** 2)
                    overlap[k] += math.exp(-apart) * light[other, c] / light[n, c]


@numba.njit(cache=True, nogil=True)
def add_camera_misses(model: Any, room: Any, particles: Any, equations: Any) -> None:
    """Add up (camera, 5) the equations of a shift of each camera's images.

    Their terms are xx, xy, yy, x and y.
    """
    for n in range(len(particles.position)):
        sum_up(model, room, particles.position[n], particles.light[n])
        for c in range(len(model.typical)):
            light = particles.light[n, c]
            for k in range(3):
                equations[c, k] += light * light * room.sums[c, Sum.XX + k]
            for k in range(3, 5):
                equations[c, k] += light * room.sums[c, Sum.XX + k]


@numba.njit(cache=True, nogil=True)
def add_shape_misses(model: Any, room: Any, particles: Any, equations: Any) -> None:
    """Add particles' equations for images' shapes, with light as it fits best.

    The unknowns of a camera are those of `ImageModel.shapes`: n = SHAPES TERMS. The equations
    (camera, n, n + 1) are normal ones, with their right sides in the last column.
    """
    (dot, slopes), both, terms = np.zeros((2, SHAPES)), np.zeros((SHAPES, SHAPES)), np.ones(TERMS)
    image = np.zeros((room.window, room.window), dtype=np.float32)
    changes = np.zeros((SHAPES, room.window, room.window), dtype=np.float32)
    for n in range(len(particles.position)):
        copy_row(particles.position[n], terms[1:4])
        terms[4] = terms[3] * terms[3]
        place_windows(model, room, particles.position[n])
        for c in range(len(model.typical)):
            column, row = room.corner[c, 0], room.corner[c, 1]
            fill_image(model, room, c, image)
            _fill_changes(model, room, c, changes)
            left, weights, light = model.left[c], model.weight[c], particles.light[n, c]
            dot[:], both[:], slopes[:], whole, pull = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(room.window):
                for j in range(room.window):
                    each = counting(weights[row + i, column + j], left[row + i, column + j])
                    share, off = image[i, j], each * left[row + i, column + j]
                    whole, pull = whole + each * share * share, pull + off * share
                    for a in range(SHAPES):
                        dot[a] += each * share * changes[a, i, j]
                        slopes[a] += off * changes[a, i, j]
                        for b in range(SHAPES):
                            both[a, b] += each * changes[a, i, j] * changes[b, i, j]
            if not whole > UNSEEN:
                continue
            for k in range(SHAPES * TERMS):
                a, p = k // TERMS, k % TERMS
                equations[c, k, -1] += light * terms[p] * (slopes[a] - dot[a] * pull / whole)
                for m in range(SHAPES * TERMS):
                    b, q = m // TERMS, m % TERMS
                    equations[c, k, m] += (
                        light * light * terms[p] * terms[q] * (both[a, b] - dot[a] * dot[b] / whole)
                    )


@numba.njit(inline="always")
def _fill_changes(model: Any, room: Any, c: int, changes: Any) -> None:
    """Fill in (shape, row, column) an image's derivatives by its shape.

    They are those of a plain image.
    """
    rows, width = room.profiles[c], room.width[c]
    higher, first = np.zeros((2, 4, room.window)), room.corner[c] - MARGIN_PX
    for k in range(2):
        fill_derivatives(room.here[c, k], width[k], first[k], higher[k])
    across, down, plain = width[0] * width[0], width[1] * width[1], is_plain(model.shapes, c)
    for i in range(room.window):
        y, y2, y4 = rows[Profile.OWN_Y, i], down * higher[1, 0, i], down * down * higher[1, 2, i]
        for j in range(room.window):
            x, x2 = rows[Profile.OWN_X, j], across * higher[0, 0, j]
            x4 = across * across * higher[0, 2, j]
            changes[0, i, j], changes[1, i, j] = x2 * y / width[0], x * y2 / width[1]
            changes[2, i, j] = rows[Profile.SLOPE_Y, i] * rows[Profile.SLOPE_X, j]
            if not plain:
                changes[2, i, j] += rows[Profile.TILT_SLOPE_Y, i] * rows[Profile.CURVE_X, j]
            changes[3, i, j] = -(x4 * y + 2.0 * x2 * y2 + x * y4)
