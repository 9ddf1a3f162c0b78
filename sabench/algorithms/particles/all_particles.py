"""Passes over all particles of a model, on all cores.

Cameras' images do not notice each other while particles are painted, nor do particles that only
look at them. The results are the same for any number of cores.
"""

from __future__ import annotations

import numpy as np

from sabench.algorithms.particles.image_model import (
    ImageModel,
    Particles,
    Room,
    make_room,
    paint_all,
)
from sabench.algorithms.particles.leverage import add_leverage, tell_taken
from sabench.algorithms.particles.model_moves import (
    add_camera_misses,
    measure_earnings,
    measure_misfit,
)
from sabench.algorithms.particles.particle_splits import measure_split_gains
from sabench.utils.arrays import F64
from sabench.utils.threads import for_each, share_rows

_PARTS = 16  # whose sums are added up, whatever the number of cores


def paint_particles(model: ImageModel, sigma: F64, particles: Particles, sign: float) -> None:
    """Add the light of particles times a sign to what is left of the images."""

    def paint(camera: int) -> None:
        one, room = _of_camera(model, sigma, camera)
        paint_all(one, room, _in_camera(particles, camera), sign)

    for_each(paint, len(sigma))


def misfits(model: ImageModel, sigma: F64, particles: Particles) -> F64:
    """Measure how far squares left around particles exceed those of noise.

    The result (n,) has the standard deviation of their sum as its unit.
    """
    out = np.zeros(len(particles.position))

    def measure(rows: slice) -> None:
        measure_misfit(model, make_room(sigma), _some(particles, rows), out[rows])

    share_rows(measure, len(out))
    return out


def split_gains(model: ImageModel, sigma: F64, particles: Particles, steps: F64) -> F64:
    """Measure how much cost a split promises to save.

    The result (n,) is that along the best of some steps (k, 3).
    """
    out = np.zeros(len(particles.position))

    def measure(rows: slice) -> None:
        measure_split_gains(model, make_room(sigma), _some(particles, rows), steps, out[rows])

    share_rows(measure, len(out))
    return out


def earnings(model: ImageModel, sigma: F64, particles: Particles) -> F64:
    """Measure how much cost particles' light saves in each camera (n, camera)."""
    out = np.zeros(particles.light.shape)

    def measure(rows: slice) -> None:
        measure_earnings(model, make_room(sigma), _some(particles, rows), out[rows])

    share_rows(measure, len(out))
    return out


def camera_misses(model: ImageModel, sigma: F64, particles: Particles) -> F64:
    """Sum up (camera, 5) what each camera alone says of a common shift of its images.

    The columns are those of `add_camera_misses`.
    """

    def add(rows: slice) -> F64:
        sums = np.zeros((len(sigma), 5))
        add_camera_misses(model, make_room(sigma), _some(particles, rows), sums)
        return sums

    return np.asarray(np.sum(share_rows(add, len(particles.position), _PARTS), axis=0))


def leverage(model: ImageModel, sigma: F64, particles: Particles) -> F64:
    """Compute how much of each pixel the fit of particles takes for itself.

    The result (camera, row, column) has margins.
    """
    taken = np.zeros((*particles.light.shape, 2))
    out = np.zeros(model.images.shape)

    def tell(rows: slice) -> None:
        tell_taken(model, make_room(sigma), _some(particles, rows), taken[rows])

    def add(camera: int) -> None:
        one, room = _of_camera(model, sigma, camera)
        own = np.ascontiguousarray(taken[:, camera])
        add_leverage(one, room, _in_camera(particles, camera), own, out[camera])

    share_rows(tell, len(taken))
    for_each(add, len(sigma))
    return out


def _of_camera(model: ImageModel, sigma: F64, camera: int) -> tuple[ImageModel, Room]:
    """Return a view of one camera alone, and room with windows as wide as in all."""
    one = slice(camera, camera + 1)
    maps = model.maps._replace(coefficients=model.maps.coefficients[one])
    view = model._replace(
        maps=maps,
        shapes=model.shapes[one],
        typical=model.typical[one],
        images=model.images[one],
        weight=model.weight[one],
        left=model.left[one],
    )
    return view, make_room(np.full((1, 2), sigma.max()))


def _in_camera(particles: Particles, camera: int) -> Particles:
    light = np.ascontiguousarray(particles.light[:, camera : camera + 1])
    return particles._replace(light=light)


def _some(particles: Particles, rows: slice) -> Particles:
    return Particles(particles.position[rows], particles.light[rows], particles.alive[rows])
