"""Pairs that look like one particle are found and split, and single particles are not."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.image_model import (
    ImageModel,
    Particles,
    paint_all,
    without_margins,
)
from sabench.algorithms.particles.model_moves import measure_split_gains, split_pairs
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64
from tests.helpers.image_model import (
    NOISE,
    TYPICAL,
    model_of,
    paint,
    particles_of,
    refine_all,
    room_of,
)
from tests.unit.algorithms.particles.test_model_moves import noisy
from tests.unit.algorithms.particles.test_triangulation import (
    COLUMNS,
    ROWS,
    distances,
    maps,
    unit_points,
)

__all__ = ["maps"]


def gains_of(model: ImageModel, maps: VolumePolynomials, particles: Particles) -> F64:
    """Gains that splits along the axes promise each particle that is in the model."""
    steps = 0.7 * pixel_mm(maps) / maps.half_mm * np.diag([1.0, 1.0, 3.0])
    gains = np.zeros(len(particles.position))
    measure_split_gains(model, room_of(maps), particles, steps, gains)
    return gains


def test_the_promise_is_the_parabola_of_costs_of_halves_that_move_apart(
    maps: VolumePolynomials,
) -> None:
    """Halves are painted a little apart here, and each camera's light is fitted to what they do."""
    point, light = np.array([[0.1, -0.2, 0.3]]), TYPICAL * np.array([[1.0, 1.5, 0.7, 1.2]])
    step = pixel_mm(maps) / maps.half_mm * np.array([[0.6, 0.3, 1.5]])
    pair = np.vstack([point + step, point - step])
    images = noisy(maps, pair, 0.5 * np.vstack([light, light]))
    particles, room = particles_of(point, light), room_of(maps)
    model = model_of(maps, images)
    paint_all(model, room, particles, -1.0)
    measure_split_gains(model, room, particles, step, gain := np.zeros(1))

    small = 0.1 * step
    halves = np.vstack([point + small, point - small])
    apart = paint(maps, halves, 0.5 * np.vstack([light, light]), ROWS, COLUMNS)
    single = paint(maps, point, light, ROWS, COLUMNS)
    left, change = without_margins(model.left).astype(np.float64), apart - single
    share = (change * single).sum(axis=(1, 2)) / (single**2).sum(axis=(1, 2))
    change -= share[:, None, None] * single
    expected = 0.5 * (left * change).sum() ** 2 / ((change**2).sum() * NOISE**2)
    assert gain[0] == pytest.approx(expected, rel=0.03)


def test_noise_promises_half_the_square_of_a_normal_deviate_if_positive(
    maps: VolumePolynomials,
) -> None:
    """Its mean is a quarter, and its variance 5 / 16, along any one step."""
    points, light = 0.8 * unit_points(200), np.full((200, 4), TYPICAL)
    model, room = model_of(maps, noisy(maps, points, light)), room_of(maps)
    particles = particles_of(points, light)
    paint_all(model, room, particles, -1.0)
    step = pixel_mm(maps) / maps.half_mm * np.array([[0.6, 0.3, 1.5]])
    measure_split_gains(model, room, particles, step, gains := np.zeros(200))
    assert gains.mean() == pytest.approx(0.25, abs=3.0 * np.sqrt(5.0 / 16.0 / 200.0))
    assert gains.max() < 12.0


def test_a_peak_of_the_wrong_height_promises_nothing(maps: VolumePolynomials) -> None:
    """Light explains it: it is no pair."""
    point, light = np.zeros((1, 3)), np.full((1, 4), TYPICAL)
    model = model_of(maps, paint(maps, point, light, ROWS, COLUMNS))
    particles = particles_of(point, light * [0.7, 1.4, 0.8, 1.3])
    paint_all(model, room_of(maps), particles, -1.0)
    assert gains_of(model, maps, particles)[0] < 0.1


def test_a_pair_stands_out_where_the_model_errs_more_than_the_noise(
    maps: VolumePolynomials,
) -> None:
    """The squares left around it are less than expected then, and tell nothing."""
    size = pixel_mm(maps) / maps.half_mm
    half = 0.8 * size * np.array([1.0, 0.0, 0.0])
    points = np.vstack([0.9 * unit_points(20), [half], [-half]])
    images = noisy(maps, points, np.full((22, 4), TYPICAL))
    seen = np.vstack([points[:20], np.zeros((1, 3))])
    light = np.full((21, 4), TYPICAL)
    light[20] *= 2.0
    model, room, particles = model_of(maps, images), room_of(maps), particles_of(seen, light)
    model.weight[:] /= 5.0
    paint_all(model, room, particles, -1.0)
    refine_all(model, room, particles, 10)
    gains = gains_of(model, maps, particles)
    assert gains[20] > 5.0 + gains[:20].max()


@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
def test_two_particles_that_look_like_one_are_split(
    maps: VolumePolynomials, direction: list[float]
) -> None:
    size = pixel_mm(maps) / maps.half_mm
    half = 0.8 * size * np.array(direction) * [1.0, 1.0, 4.0]
    pair = np.array([half, -half])
    images = noisy(maps, pair, np.full((2, 4), TYPICAL))
    model, room = model_of(maps, images), room_of(maps)
    rows, lights = np.zeros((2, 3)), np.full((2, 4), 2.0 * TYPICAL)
    particles = Particles(rows, lights, np.array([True, False]))
    single = Particles(rows[:1], lights[:1], np.ones(1, dtype=np.bool_))
    paint_all(model, room, single, -1.0)
    refine_all(model, room, single, 10)
    steps = 0.7 * size * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    measure_split_gains(model, room, single, steps, gain := np.zeros(1))
    assert gain[0] > 20.0
    order = np.zeros(1, dtype=np.int64)
    split_pairs(model, room, particles, order, np.ones(1, dtype=np.int64), steps)
    assert particles.alive.all()
    refine_all(model, room, particles, 20)
    assert distances(particles.position, pair, maps).max() < 0.3 * pixel_mm(maps)
    measure_split_gains(model, room, particles, steps, two := np.zeros(2))
    assert two.max() < 4.0


def test_a_single_particle_is_not_split(maps: VolumePolynomials) -> None:
    point, light = np.zeros((1, 3)), np.full((1, 4), TYPICAL)
    model, room = model_of(maps, noisy(maps, point, light)), room_of(maps)
    particles = Particles(np.zeros((2, 3)), np.full((2, 4), TYPICAL), np.array([True, False]))
    paint_all(model, room, particles_of(point, light), -1.0)
    left, size = model.left.copy(), pixel_mm(maps) / maps.half_mm
    steps = 0.7 * size * np.eye(3)
    order = np.zeros(1, dtype=np.int64)
    split_pairs(model, room, particles, order, np.ones(1, dtype=np.int64), steps)
    assert particles.alive.tolist() == [True, False]
    np.testing.assert_allclose(particles.position[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(model.left, left, atol=1e-3)


def test_a_wide_particle_is_not_split(maps: VolumePolynomials) -> None:
    """Two so near that no camera sees them apart are one with a wider image."""
    size = pixel_mm(maps) / maps.half_mm
    pair = 0.15 * size * np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
    images = noisy(maps, pair, np.full((2, 4), 50.0 * TYPICAL))
    model, room = model_of(maps, images), room_of(maps)
    light = np.full((2, 4), 100.0 * TYPICAL)
    particles = Particles(np.zeros((2, 3)), light, np.array([True, False]))
    single = Particles(np.zeros((1, 3)), light[:1], np.ones(1, dtype=np.bool_))
    paint_all(model, room, single, -1.0)
    order = np.zeros(1, dtype=np.int64)
    steps = 0.15 * size * np.ones((1, 3))
    measure_split_gains(model, room, single, steps, gain := np.zeros(1))
    assert gain[0] > 100.0
    split_pairs(model, room, particles, order, np.ones(1, dtype=np.int64), steps)
    assert particles.alive.tolist() == [True, False]
