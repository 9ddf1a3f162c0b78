"""Noise, light, widths and shifts of cameras, learned from a search's particles."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.all_particles import camera_misses, misfits
from sabench.algorithms.particles.image_model import MOST_FLAT, SHAPES
from sabench.algorithms.particles.image_statistics import LEAST_TILTED
from sabench.algorithms.particles.light_prior import learn_covariance
from sabench.algorithms.particles.lone_particles import find_lone
from sabench.algorithms.particles.model_moves import add_shape_misses
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.algorithms.particles.pixel_variance import fill_variance
from sabench.utils.arrays import F64, I64
from sabench.utils.threads import for_each

_FEW = 30  # particles that tell nothing of all
_ALIGNMENTS, _FARTHEST_PX = 2, 0.5  # steps of cameras' shifts, and the longest of each
_WIDTH_ERROR, _WIDTH_CHANGE = 0.2, 0.05  # of the first widths, and over the box: their scatter
_TILT_CHANGE = 0.2  # of tilts, at first and over the box
_TILTED = 0.2  # correlation somewhere in the box that costs particles
_FLAT_CHANGE = 0.02  # of flatness, at first and over the box
_SHAPE_ERRORS = np.array(
    [[_WIDTH_ERROR, *[_WIDTH_CHANGE] * 3]] * 2 + [[_TILT_CHANGE] * 4, [_FLAT_CHANGE] * 4]
)
_SHAPE_STEPS = np.array([[_WIDTH_CHANGE], [_WIDTH_CHANGE], [_TILT_CHANGE], [_FLAT_CHANGE]])
_WIDTH_STEPS = 2


def weigh_pixels(search: ParticleSearch, cap: float) -> None:
    """Estimate the variance of every pixel from what is left.

    It is the noise of dark pixels and a share of the model's light; the part above the dark
    noise is at most `cap` of a typical peak squared, but not less than what particles leave
    whose images are a little wider or narrower than others', or what particles that are not
    found yet leave.
    """
    peaks = search.peaks()

    def weigh(camera: int) -> None:
        fill_variance(
            search.images[camera],
            search.left[camera],
            search.known[camera],
            search.saturated[camera],
            float(search.noise[camera]) ** 2,
            (cap * float(peaks[camera])) ** 2,
            search.variance[camera],
        )

    for_each(weigh, len(peaks))


def learn_light(search: ParticleSearch) -> None:
    """Learn typical light and its covariance from the particles that stand alone."""
    lone = _lone(search)
    if len(lone) < _FEW:
        return
    logs = np.log(search.light[lone] / search.typical)
    search.typical = search.typical * np.exp(np.median(logs, axis=0))
    search.covariance = learn_covariance(logs)


def learn_widths(search: ParticleSearch) -> None:
    """Learn the shapes of images, and how they change, from lone particles.

    Half of them count, those that leave least of their images: others may be two. Few must be
    missing yet, because what they leave makes others wider.
    """
    lone = _lone(search)
    if len(lone) < _FEW:
        return
    model, particles, cameras = search.model(), search.particles(), len(search.images)
    misfit = misfits(model, search.widest, particles)
    misfit = misfit[lone] / search.common_light()[lone] ** 2
    lone = lone[misfit <= np.median(misfit)]
    for _ in range(_WIDTH_STEPS):
        unknowns = 4 * SHAPES
        matrices, right = np.zeros((cameras, unknowns, unknowns)), np.zeros((cameras, unknowns))
        add_shape_misses(model, search.room, particles, lone, matrices, right)
        areas = search.sigma.prod(axis=1)
        units = np.column_stack([search.sigma, areas, np.ones(cameras)])[:, :, None]
        known = (_SHAPE_ERRORS * units) ** -2.0
        right -= (known * (search.shapes - search.first_shapes)).reshape(cameras, -1)
        matrices += known.reshape(cameras, -1, 1) * np.eye(unknowns)
        _keep_plain(search, matrices, right)
        step = np.linalg.solve(matrices, right[:, :, None]).reshape(search.shapes.shape)
        most = _SHAPE_STEPS * units
        search.shapes += np.clip(step, -most, most)
        np.clip(search.shapes[:, 3, 0], 0.0, MOST_FLAT, out=search.shapes[:, 3, 0])
        search.subtract_all()


def _keep_plain(search: ParticleSearch, matrices: F64, right: F64) -> None:
    """Take tilts out of the equations of cameras whose images have hardly any.

    They would only slow the fits down. Flatness counts where the images had some at first.
    """
    tilts = np.linalg.solve(matrices[:, 8:12, 8:12], right[:, 8:12, None])[:, :, 0]
    farthest = np.abs(tilts).sum(axis=1) / search.sigma.prod(axis=1)
    upright = (search.shapes[:, 2, 0] == 0.0) & (
        (farthest < _TILTED) | (search.sigma.min(axis=1) < LEAST_TILTED)
    )
    without = np.stack([upright, search.shapes[:, 3, 0] == 0.0], axis=1)
    for camera, term in np.argwhere(without):
        own = slice(8 + 4 * term, 12 + 4 * term)
        matrices[camera, own], matrices[camera, :, own], right[camera, own] = 0.0, 0.0, 0.0
        matrices[camera, own, own] = np.eye(4)


def align_cameras(search: ParticleSearch) -> None:
    """Shift each camera's pixels to where it sees the particles.

    A shift that particles take part in, as one of all cameras, cannot be seen.
    """
    if len(search.position) < _FEW:
        return
    for _ in range(_ALIGNMENTS):
        sums = camera_misses(search.model(), search.widest, search.particles())
        xx, xy, yy, x, y = sums.T
        matrix = np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=2)
        shifts = np.zeros((len(matrix), 2))
        there = np.linalg.det(matrix) > 0.0  # cameras that see some particles
        right = np.stack([x, y], axis=1)[there, :, None]
        shifts[there] = np.linalg.solve(matrix[there], right)[:, :, 0]
        search.maps.coefficients[:, 0] += np.clip(shifts, -_FARTHEST_PX, _FARTHEST_PX)
        search.subtract_all()
        search.refine(1)


def _lone(search: ParticleSearch) -> I64:
    return find_lone(
        search.maps, search.position, search.light, search.sigma, search.images.shape[1:]
    )
