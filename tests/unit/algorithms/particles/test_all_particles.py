"""Passes over all particles give what one thread gives, for any number of cores."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from sabench.algorithms.particles.all_particles import (
    leverage,
    misfits,
    paint_particles,
    split_gains,
)
from sabench.algorithms.particles.image_model import ImageModel, Particles, paint_all
from sabench.algorithms.particles.learned_model import add_camera_misses, camera_misses
from sabench.algorithms.particles.model_moves import measure_misfit
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F32, F64
from tests.helpers.image_model import (
    NOISE,
    SIGMA,
    TYPICAL,
    model_of,
    paint,
    particles_of,
    room_of,
)
from tests.unit.algorithms.particles.test_triangulation import COLUMNS, ROWS, maps, unit_points

__all__ = ["maps"]
COUNT, SIGMAS = 120, np.tile(np.array(SIGMA), (4, 1))
MOST = numba.config.NUMBA_NUM_THREADS


def case(maps: VolumePolynomials) -> tuple[ImageModel, Particles]:
    """A model of noisy images, and particles that are a little off."""
    rng = np.random.default_rng(2)
    points = unit_points(COUNT)
    light = TYPICAL * np.exp(0.2 * rng.standard_normal((COUNT, 4)))
    images = paint(maps, points, light, ROWS, COLUMNS)
    images += NOISE * rng.standard_normal(images.shape)
    return model_of(maps, images), particles_of(points + 0.001, light)


def outcome(maps: VolumePolynomials) -> list[F64 | F32]:
    """Results of all passes."""
    model, particles = case(maps)
    paint_particles(model, SIGMAS, particles, -1.0)
    return [
        model.left,
        misfits(model, SIGMAS, particles),
        camera_misses(model, SIGMAS, particles),
        leverage(model, SIGMAS, particles),
        split_gains(model, SIGMAS, particles, 0.02 * np.eye(3)),
    ]


def test_passes_give_what_one_thread_gives(maps: VolumePolynomials) -> None:
    left, misfit, misses, *_ = outcome(maps)
    model, particles = case(maps)
    room, alone, sums = room_of(maps), np.zeros(COUNT), np.zeros((4, 5))
    paint_all(model, room, particles, -1.0)
    np.testing.assert_array_equal(left, model.left)
    measure_misfit(model, room, particles, alone)
    np.testing.assert_array_equal(misfit, alone)
    add_camera_misses(model, room, particles, sums)
    np.testing.assert_allclose(misses, sums, rtol=1e-9, atol=1e-9 * np.abs(sums).max())


@pytest.mark.skipif(MOST < 2, reason="one core")
def test_threads_change_nothing(maps: VolumePolynomials) -> None:
    many = outcome(maps)
    numba.set_num_threads(1)
    try:
        one = outcome(maps)
    finally:
        numba.set_num_threads(MOST)
    for a, b in zip(many, one, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_fit_takes_as_much_as_it_has_unknowns(maps: VolumePolynomials) -> None:
    points = unit_points(COUNT)[:1]
    light = np.full((1, 4), 1000.0 * TYPICAL)  # the prior tells nothing
    model = model_of(maps, paint(maps, points, light, ROWS, COLUMNS), between=1.0)
    taken = leverage(model, SIGMAS, particles_of(points, light))
    assert taken.sum() == pytest.approx(4.0 + 3.0, rel=0.01)
