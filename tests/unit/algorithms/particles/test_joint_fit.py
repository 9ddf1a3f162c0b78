"""Fits of particles to images: costs against their definition, results against truth."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from sabench.algorithms.particles import joint_fit
from sabench.algorithms.particles.image_model import (
    ImageModel,
    ModelParticles,
    look,
    paint_all,
    without_margins,
)
from sabench.utils.arrays import F64, Bool
from tests.helpers.image_model import (
    NOISE,
    TYPICAL,
    model_of,
    paint,
    particles_of,
    refine_all,
    room_of,
)
from tests.helpers.particle_box import COLUMNS, ROWS, Maps, distances, unit_points

RNG = np.random.default_rng(8)
COUNT = 30
LIGHT = TYPICAL * np.exp(0.3 * RNG.standard_normal((COUNT, 1)) + 0.1 * RNG.standard_normal((30, 4)))


def whole_cost(model: ImageModel, particles: ModelParticles, images: F64) -> float:
    """Minus the logarithm of the probability of images and lights, from its definition."""
    left = images - paint(model.maps, particles.position, particles.light, ROWS, COLUMNS)
    logs = np.log(particles.light / model.typical)
    prior = np.einsum("ni,ij,nj->", logs, model.precision, logs)
    return float(0.5 * (left**2 * without_margins(model.weight)).sum() + 0.5 * prior)


def test_changes_of_cost_are_those_of_the_whole_images(maps: Maps) -> None:
    points = 0.3 * unit_points(COUNT)  # many overlap
    images = paint(maps, points, LIGHT, ROWS, COLUMNS)
    images += NOISE * RNG.standard_normal(images.shape)
    model, room = model_of(maps, images), room_of(maps)
    particles = particles_of(points + 0.004 * RNG.standard_normal(points.shape), LIGHT)
    paint_all(model, room, particles, -1.0)
    before = whole_cost(model, particles, images)
    changes = [joint_fit.fit_particle(model, room, particles, n) for n in range(COUNT)]
    assert max(changes) <= 0.0
    after = whole_cost(model, particles, images)
    assert sum(changes) == pytest.approx(after - before, rel=1e-3)
    total = refine_all(model, room, particles, 2)
    assert total == pytest.approx(whole_cost(model, particles, images) - after, rel=1e-2)
    # what is left of the images has been kept up to date
    left = images - paint(maps, particles.position, particles.light, ROWS, COLUMNS)
    assert_allclose(without_margins(model.left), left, atol=5e-3)  # the images end at their windows


def test_overlapping_particles_are_found_where_they_are(maps: Maps) -> None:
    points = 0.5 * unit_points(COUNT)
    images = paint(maps, points, LIGHT, ROWS, COLUMNS)
    model, room = model_of(maps, images, between=0.3), room_of(maps)
    start = points + 0.05 * RNG.uniform(-1.0, 1.0, points.shape) / maps.half_mm
    particles = particles_of(start, np.zeros_like(LIGHT))
    joint_fit.start_light(model, room, particles, np.arange(COUNT))
    refine_all(model, room, particles, 25)
    errors = distances(particles.position, points, maps)
    assert np.median(errors) < 2e-4
    assert errors.max() < 0.02  # two of them are one pixel apart
    assert np.median(np.abs(particles.light / LIGHT - 1.0)) < 0.005


def saturate(model: ImageModel, most: float) -> tuple[ImageModel, Bool]:
    saturated = model.images >= most
    cut = np.minimum(model.images, np.float32(most))
    weight = np.where(saturated, -model.weight, model.weight)
    return model._replace(images=cut, left=cut.copy(), weight=weight), saturated


def test_saturated_pixels_ask_for_as_much_light_as_they_show_or_more(maps: Maps) -> None:
    points = 0.5 * unit_points(COUNT)
    images = paint(maps, points, LIGHT, ROWS, COLUMNS)
    model, saturated = saturate(model_of(maps, images, between=0.3), 0.2 * TYPICAL)
    assert 0.2 < np.mean([saturated[c].sum() / COUNT for c in range(4)]) / 5.0 < 2.0
    room = room_of(maps)
    start = points + 0.02 * RNG.uniform(-1.0, 1.0, points.shape) / maps.half_mm
    errors = []
    for one in (model, model._replace(weight=np.abs(model.weight))):
        particles = particles_of(start, LIGHT)
        one.left[:] = one.images
        paint_all(one, room, particles, -1.0)
        refine_all(one, room, particles, 40)
        errors.append(np.median(distances(particles.position, points, maps)))
    assert errors[0] < 2e-4
    assert errors[1] > 10.0 * errors[0]  # as if the light ended where the sensor's range does


def test_light_beyond_saturation_costs_nothing_and_less_does(maps: Maps) -> None:
    point, light = np.zeros((1, 3)), np.full((1, 4), TYPICAL)
    images = paint(maps, point, light, ROWS, COLUMNS)
    model, saturated = saturate(model_of(maps, images), 0.2 * TYPICAL)
    costs = []
    for share in (1.0, 0.5):
        room = room_of(maps)
        look(model, room, point[0], share * light[0])
        costs.append(joint_fit.cost_of(model, room, share * light[0]))
        shown, weight = without_margins(model.images), without_margins(np.abs(model.weight))
        left = shown - share * images
        squares = np.where(without_margins(saturated) & (left < 0.0), 0.0, left) ** 2 - shown**2
        logs = np.full(4, np.log(share))
        expected = 0.5 * (weight * squares).sum() + 0.5 * logs @ model.precision @ logs
        assert costs[-1] == pytest.approx(expected, rel=0.01)  # images end at their windows
    assert costs[0] < costs[1]


def test_errors_of_places_are_as_large_as_the_price_says(maps: Maps) -> None:
    """A penalty grows by the logarithm of how much better places are known."""
    point, light = np.zeros(3), np.full(4, TYPICAL)
    model, room = model_of(maps, np.zeros((4, ROWS, COLUMNS))), room_of(maps)
    sharp = model._replace(weight=100.0 * model.weight)
    gain = joint_fit.penalty(sharp, room, point, light) - joint_fit.penalty(
        model, room, point, light
    )
    assert gain == pytest.approx(3.0 * np.log(10.0) + 4.0 * np.log(10.0), abs=3.0)
    rare = model._replace(log_rate=model.log_rate - 2.0)
    assert joint_fit.penalty(rare, room, point, light) - joint_fit.penalty(
        model, room, point, light
    ) == pytest.approx(2.0)


def test_three_equations_are_solved_unless_they_say_too_little() -> None:
    matrix = RNG.standard_normal((3, 3))
    matrix = matrix @ matrix.T + 0.1 * np.eye(3)
    right, step = RNG.standard_normal(3), np.zeros(3)
    determinant = joint_fit.solve_three(matrix, right, step)
    assert_allclose(step, np.linalg.solve(matrix, right))
    assert determinant == pytest.approx(np.linalg.det(matrix))
    assert joint_fit.solve_three(np.ones((3, 3)), right, step) == 0.0
    assert joint_fit.solve_three(np.zeros((3, 3)), right, step) == 0.0


MEDIANS = np.array([100.0, 120.0, 80.0, 100.0])


def best(signal: F64, weight: F64, precision: F64) -> tuple[F64, float]:
    logs = np.zeros(4)
    cost = joint_fit.find_light(
        signal, weight, MEDIANS, precision, logs, np.zeros(4), np.zeros((4, 4))
    )
    return logs, cost


@pytest.mark.parametrize("scatter", [0.05, 0.4])
@pytest.mark.parametrize("noise", [2.0, 60.0])
def test_the_light_found_is_the_most_probable(scatter: float, noise: float) -> None:
    precision: F64 = np.linalg.inv(joint_fit.even_covariance(4, scatter, 0.5)).astype(np.float64)
    rng = np.random.default_rng(1)
    for _ in range(5):
        light = MEDIANS * np.exp(rng.multivariate_normal(np.zeros(4), np.linalg.inv(precision)))
        weight = np.full(4, 1.0 / noise**2)
        signal = weight * (light + noise * rng.standard_normal(4))

        def cost(logs: F64, signal: F64 = signal, weight: F64 = weight) -> float:
            return float(joint_fit.light_cost(signal, weight, MEDIANS, precision, logs))

        logs, least = best(signal, weight, precision)
        starts = [minimize(cost, start * np.ones(4)).fun for start in (-1.0, 0.0, 0.5)]
        assert least <= min(starts) + 1e-3
        assert least == pytest.approx(cost(logs))


def test_a_camera_that_sees_nothing_gets_the_light_that_the_others_suggest() -> None:
    precision: F64 = np.linalg.inv(joint_fit.even_covariance(4, 0.05, 0.5)).astype(np.float64)
    weight = np.array([1.0, 1.0, 1.0, 0.0])
    logs, _ = best(1.5 * MEDIANS * weight, weight, precision)
    assert_allclose(logs, math.log(1.5), atol=0.02)


def test_the_cost_is_a_log_probability() -> None:
    """Against the normal densities of data and lights, relative to no light."""
    covariance = joint_fit.even_covariance(4, 0.3, 0.4)
    weight, data = np.array([0.2, 0.3, 0.1, 0.4]), np.array([90.0, 130.0, 70.0, 20.0])
    logs = np.array([0.1, -0.2, 0.3, -0.4])
    light = MEDIANS * np.exp(logs)
    squares = weight * ((data - light) ** 2 - data**2)
    expected = 0.5 * squares.sum() + 0.5 * logs @ np.linalg.solve(covariance, logs)
    cost = joint_fit.light_cost(weight * data, weight, MEDIANS, np.linalg.inv(covariance), logs)
    assert cost == pytest.approx(expected)


def test_covariances_are_learned_in_spite_of_outliers() -> None:
    true = joint_fit.even_covariance(4, 0.3, 0.4)
    true[0, 2] = true[2, 0] = 0.24  # two cameras that see much the same lobe
    rng = np.random.default_rng(2)
    logs = 0.7 + rng.multivariate_normal(np.zeros(4), true, 2000)
    logs[:40] = rng.uniform(-4.0, 4.0, (40, 4))
    assert_allclose(joint_fit.learn_covariance(logs), true, atol=0.05)


@pytest.mark.parametrize("cameras", [3, 9])
def test_a_covariance_is_not_too_small(cameras: int) -> None:
    true = joint_fit.even_covariance(cameras, 0.1, 0.3)
    logs = np.random.default_rng(3).multivariate_normal(np.zeros(cameras), true, 50_000)
    found = joint_fit.learn_covariance(logs) - joint_fit.OWN_ERROR**2 * np.eye(cameras)
    assert_allclose(found, true, rtol=0.03)


def test_scatter_between_cameras_leaves_out_what_they_share() -> None:
    assert joint_fit.scatter_between(joint_fit.even_covariance(5, 0.3, 2.0)) == pytest.approx(0.3)
    assert joint_fit.scatter_between(np.array([[0.2]])) == pytest.approx(math.sqrt(0.2))


def test_factors_give_the_determinant() -> None:
    matrix = np.random.default_rng(6).standard_normal((5, 5))
    matrix = matrix @ matrix.T + np.eye(5)
    factor = matrix.copy()
    joint_fit.factorise_cholesky(factor)
    assert joint_fit.log_determinant(factor) == pytest.approx(np.linalg.slogdet(matrix)[1])
    assert_allclose(np.tril(factor) @ np.tril(factor).T, matrix)
