"""Ghosts are removed and pairs split, single particles are neither."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.particles import image_model, model_moves
from sabench.algorithms.particles.all_particles import some_rows
from sabench.algorithms.particles.candidate_search import pixel_mm
from sabench.algorithms.particles.learned_model import add_camera_misses, add_shape_misses
from sabench.geometry.volume_polynomials import project_points
from sabench.utils.arrays import F64
from tests.helpers.image_model import (
    NOISE,
    SIGMA,
    TYPICAL,
    model_of,
    paint,
    particles_of,
    refine_all,
    room_of,
)
from tests.helpers.particle_box import COLUMNS, ROWS, Maps, distances, unit_points

WIDTHS = np.tile(np.array(SIGMA), (4, 1))


def noisy(maps: Maps, points: F64, light: F64) -> F64:
    """Images of particles with noise: the same at each call."""
    images = paint(maps, points, light, ROWS, COLUMNS)
    return np.asarray(images + NOISE * np.random.default_rng(9).standard_normal(images.shape))


def subtracted(
    maps: Maps, images: F64, points: F64, light: F64, between: float = 0.1
) -> tuple[image_model.ImageModel, image_model.Room, image_model.ModelParticles]:
    """A model of images from which particles are subtracted."""
    model, room = model_of(maps, images, between), room_of(maps)
    particles = particles_of(points, light)
    image_model.paint_all(model, room, particles, -1.0)
    return model, room, particles


def even_light(count: int, share: float = 1.0) -> F64:
    return np.full((count, 4), share * TYPICAL)


def one_of_two(maps: Maps, images: F64, share: float, middle: float = 0.0) -> Any:
    """A model without one particle in the middle, room for another, and that one alone."""
    model, room, lights = model_of(maps, images), room_of(maps), even_light(2, share)
    rows, alive = np.zeros((2, 3)) + middle, np.array([True, False])
    single = image_model.ModelParticles(rows[:1], lights[:1], alive[:1])
    image_model.paint_all(model, room, single, -1.0)
    return model, room, image_model.ModelParticles(rows, lights, alive), single


def split(model: Any, room: Any, particles: image_model.ModelParticles, steps: F64) -> None:
    """Try to split particle 0 into itself and particle 1, which is not alive yet."""
    order, row = np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64)
    model_moves.split_pairs(model, room, particles, order, row, steps)


def crossing(maps: Maps, ghost: F64) -> F64:
    """Four particles, each of which one camera sees where it sees the ghost."""
    out = []
    for camera, depth in enumerate((-0.7, -0.4, 0.4, 0.7)):
        point, goal = ghost.copy(), project_points(maps, camera, ghost[None])[0]
        point[2] = depth
        for _ in range(30):
            off = goal - project_points(maps, camera, point[None])[0]
            slope = (project_points(maps, camera, point + 1e-4 * np.eye(3)[:2]) - goal + off) / 1e-4
            point[:2] += np.linalg.solve(slope.T, off)
        out.append(point)
    return np.array(out)


@pytest.mark.slow
def test_a_ghost_of_four_particles_is_removed_and_they_get_their_light_back(maps: Maps) -> None:
    ghost = np.array([0.05, -0.1, 0.1])
    true = crossing(maps, ghost)
    light = even_light(4)
    images = noisy(maps, true, light)
    shared = light.copy()
    shared[np.arange(4), np.arange(4)] *= 0.5  # the ghost has half of one image of each
    given = np.vstack([true, ghost]), np.vstack([shared, 0.5 * light[:1]])
    model, room, particles = subtracted(maps, images, *given, 0.3)
    starts, near = model_moves.find_neighbours(maps, WIDTHS, particles.position)
    assert set(near[starts[4] :]) == {0, 1, 2, 3}
    sure, odds = np.zeros(5, dtype=np.bool_), np.zeros(5)
    rest = np.arange(5)[::-1].copy(), starts, near, 4, True, sure, odds
    assert model_moves.remove_ghosts(model, room, particles, *rest) == 1
    assert sure.tolist() == [True] * 4 + [False]
    assert (odds > 10.0).tolist() == [True] * 4 + [False]
    assert particles.alive.tolist() == [True] * 4 + [False]
    kept = image_model.ModelParticles(
        particles.position[:4], particles.light[:4], particles.alive[:4]
    )
    refine_all(model, room, kept, 10)
    assert np.abs(kept.light / light - 1.0).max() < 0.1


@pytest.mark.slow
def test_light_in_one_camera_alone_is_no_particle(maps: Maps) -> None:
    point = np.zeros((1, 3))
    images = noisy(maps, point, np.array([[1e-3, 3.0 * TYPICAL, 1e-3, 1e-3]]))
    starts, near = np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64)
    for lone, expected in ((True, 1), (False, 0)):
        guess = np.array([[8.0, 3.0 * TYPICAL, 8.0, 8.0]])
        model, room, particles = subtracted(maps, images, point, guess, 1.0)
        rest = np.arange(1), starts, near, 1, lone, np.zeros(1, dtype=np.bool_), np.zeros(1)
        assert model_moves.remove_ghosts(model, room, particles, *rest) == expected


@pytest.mark.slow
def test_of_two_at_one_place_one_is_removed_and_none_of_two_apart(maps: Maps) -> None:
    size, light = pixel_mm(maps) / maps.half_mm, even_light(2)
    for apart, expected in ((0.0, 1), (6.0, 0)):
        pair = apart * size * np.array([[0.5, 0.5, 0.0], [-0.5, -0.5, 0.0]])
        share = 1.0 if apart else 0.5
        images = noisy(maps, pair, share * light)
        model, room, particles = subtracted(maps, images, pair, share * light, 0.3)
        starts, near = model_moves.find_neighbours(maps, WIDTHS, pair)
        sure, odds = np.zeros(2, dtype=np.bool_), np.zeros(2)
        rest = np.arange(2), starts, near, 3, True, sure, odds
        assert model_moves.remove_ghosts(model, room, particles, *rest) == expected
        assert sure.sum() == 2 - expected


@pytest.mark.slow
def test_true_particles_stay_and_nothing_moves(maps: Maps) -> None:
    points, light = 0.5 * unit_points(30), even_light(30)
    model, room, particles = subtracted(maps, noisy(maps, points, light), points, light)
    left = model.left.copy()
    starts, near = model_moves.find_neighbours(maps, WIDTHS, points)
    order, sure = np.arange(30), np.zeros(30, dtype=np.bool_)
    rest = order, starts, near, 2, True, sure, np.zeros(30)
    assert model_moves.remove_ghosts(model, room, particles, *rest) == 0
    assert sure.all()
    assert_array_equal(particles.position, points)
    assert_array_equal(particles.light, light)
    assert_allclose(model.left, left, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("shaped", [False, True])
def test_shapes_that_change_over_the_box_are_learned(maps: Maps, shaped: bool) -> None:
    """Of two cameras, one has other widths, and one may have tilted or flat images."""
    points, light = 0.8 * unit_points(30), even_light(30)
    model, room = model_of(maps, np.zeros((4, ROWS, COLUMNS))), room_of(maps)
    expected = model.shapes.copy()
    expected[2, :2] += 0.02 * np.array([[1.0, -1.0, 0.5, 2.0, 3.0], [-1.0, 1.5, 1.0, 0.5, 2.0]])
    if shaped:
        expected[1, 2] = 0.02 * np.array([5.0, -2.0, 1.0, 2.0, 1.0])
        expected[3, 3] = 0.02 * np.array([2.0, 0.5, -0.5, 0.2, 0.3])
    model.shapes[:] = expected
    image_model.paint_all(model, room, particles_of(points, light), -1.0)
    images = -image_model.without_margins(model.left).astype(np.float64)
    model, particles = model_of(maps, images), particles_of(points, 1.1 * light)
    particles.light[:, 2] *= 0.95  # as if its images were narrower
    image_model.paint_all(model, room, particles, -1.0)
    for _ in range(4):
        equations = np.zeros((4, 20, 21))
        add_shape_misses(model, room, some_rows(particles, slice(30)), equations)
        matrices, right = equations[:, :, :-1], equations[:, :, -1]
        matrices[:3, 15:], matrices[:3, :, 15:], right[:3, 15:] = 0.0, 0.0, 0.0
        matrices[:3, 15:, 15:] = np.eye(5)  # these are known not to be flat
        steps = np.linalg.solve(matrices, right[:, :, None])
        model.shapes[:] += steps.reshape(model.shapes.shape)
        model.left[:] = model.images
        image_model.paint_all(model, room, particles, -1.0)
        refine_all(model, room, particles, 2)
    assert_allclose(model.shapes, expected, atol=2e-3)


@pytest.mark.slow
def test_a_far_tail_alone_says_nothing_of_widths(maps: Maps) -> None:
    """Its squared image there is less than the least number: quotients by it have no bound."""
    images = paint(maps, np.zeros((1, 3)), even_light(1), ROWS, COLUMNS)
    particles = particles_of(np.zeros((1, 3)), even_light(1))
    model, room = model_of(maps, images), room_of(maps)
    column, row = np.rint(project_points(maps, 2, np.zeros((1, 3)))[0]).astype(int)
    model.weight[2] = 0.0
    image_model.without_margins(model.weight[2])[row - 2, column - 2] = 1.0
    for width in np.linspace(0.15, 0.3, 31):
        model.shapes[:, :2, 0] = width
        equations = np.zeros((4, 20, 21))
        add_shape_misses(model, room, particles, equations)
        assert np.abs(equations[2, :, :-1]).max() < 1e-6


def test_a_shift_of_a_camera_shows_in_its_equations(maps: Maps) -> None:
    points, light = 0.8 * unit_points(30), even_light(30)
    shifted = maps._replace(coefficients=maps.coefficients.copy())
    shifted.coefficients[1, 0] += [0.04, -0.06]
    images = paint(shifted, points, light, ROWS, COLUMNS)
    model, room, particles = subtracted(maps, images, points, light)
    sums = np.zeros((4, 5))
    add_camera_misses(model, room, particles, sums)
    for camera, (xx, xy, yy, x, y) in enumerate(sums):
        shift = np.linalg.solve([[xx, xy], [xy, yy]], [x, y])
        expected = [0.04, -0.06] if camera == 1 else [0.0, 0.0]
        assert_allclose(shift, expected, atol=3e-3)


def gains_of(
    model: image_model.ImageModel, maps: Maps, particles: image_model.ModelParticles
) -> F64:
    """Gains that splits along the axes promise each particle that is in the model."""
    steps = 0.7 * pixel_mm(maps) / maps.half_mm * np.diag([1.0, 1.0, 3.0])
    gains = np.zeros(len(particles.position))
    model_moves.measure_split_gains(model, room_of(maps), particles, steps, gains)
    return gains


@pytest.mark.slow
def test_the_promise_is_the_parabola_of_costs_of_halves_that_move_apart(maps: Maps) -> None:
    """Halves are painted a little apart here, and each camera's light is fitted to what they do."""
    point, light = np.array([[0.1, -0.2, 0.3]]), TYPICAL * np.array([[1.0, 1.5, 0.7, 1.2]])
    step = pixel_mm(maps) / maps.half_mm * np.array([[0.6, 0.3, 1.5]])
    images = noisy(maps, np.vstack([point + step, point - step]), 0.5 * np.vstack([light, light]))
    model, room, particles = subtracted(maps, images, point, light)
    model_moves.measure_split_gains(model, room, particles, step, gain := np.zeros(1))

    small = 0.1 * step
    halves = np.vstack([point + small, point - small])
    apart = paint(maps, halves, 0.5 * np.vstack([light, light]), ROWS, COLUMNS)
    single = paint(maps, point, light, ROWS, COLUMNS)
    left, change = image_model.without_margins(model.left).astype(np.float64), apart - single
    share = (change * single).sum(axis=(1, 2)) / (single**2).sum(axis=(1, 2))
    change -= share[:, None, None] * single
    expected = 0.5 * (left * change).sum() ** 2 / ((change**2).sum() * NOISE**2)
    assert gain[0] == pytest.approx(expected, rel=0.03)


def test_noise_promises_half_the_square_of_a_normal_deviate_if_positive(maps: Maps) -> None:
    """Its mean is a quarter, and its variance 5 / 16, along any one step."""
    points, light = 0.8 * unit_points(200), even_light(200)
    model, room, particles = subtracted(maps, noisy(maps, points, light), points, light)
    step = pixel_mm(maps) / maps.half_mm * np.array([[0.6, 0.3, 1.5]])
    model_moves.measure_split_gains(model, room, particles, step, gains := np.zeros(200))
    assert gains.mean() == pytest.approx(0.25, abs=3.0 * np.sqrt(5.0 / 16.0 / 200.0))
    assert gains.max() < 12.0


def test_a_peak_of_the_wrong_height_promises_nothing(maps: Maps) -> None:
    """Light explains it: it is no pair."""
    point, light = np.zeros((1, 3)), even_light(1)
    images = paint(maps, point, light, ROWS, COLUMNS)
    model, _, particles = subtracted(maps, images, point, light * [0.7, 1.4, 0.8, 1.3])
    assert gains_of(model, maps, particles)[0] < 0.1


def test_a_pair_stands_out_where_the_model_errs_more_than_the_noise(maps: Maps) -> None:
    """The squares left around it are less than expected then, and tell nothing."""
    size = pixel_mm(maps) / maps.half_mm
    half = 0.8 * size * np.array([1.0, 0.0, 0.0])
    points = np.vstack([0.9 * unit_points(20), [half], [-half]])
    images = noisy(maps, points, even_light(22))
    seen = np.vstack([points[:20], np.zeros((1, 3))])
    light = even_light(21)
    light[20] *= 2.0
    model, room, particles = subtracted(maps, images, seen, light)
    model.weight[:] /= 5.0
    refine_all(model, room, particles, 10)
    gains = gains_of(model, maps, particles)
    assert gains[20] > 5.0 + gains[:20].max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("direction", "at"), [([1.0, 0.0, 0.0], 0.3), ([0.0, 0.6, 0.8], 0.0), ([0.0, 1.0, 0.0], -0.3)]
)
def test_two_particles_that_look_like_one_are_split(
    maps: Maps, direction: list[float], at: float
) -> None:
    size = pixel_mm(maps) / maps.half_mm
    half = 0.8 * size * np.array(direction) * [1.0, 1.0, 4.0]
    pair = at + np.array([half, -half])
    model, room, particles, single = one_of_two(maps, noisy(maps, pair, even_light(2)), 2.0, at)
    refine_all(model, room, single, 10)
    steps = 0.7 * size * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
    model_moves.measure_split_gains(model, room, single, steps, gain := np.zeros(1))
    assert gain[0] > 20.0
    split(model, room, particles, steps)
    assert particles.alive.all()
    refine_all(model, room, particles, 20)
    assert distances(particles.position, pair, maps).max() < 0.3 * pixel_mm(maps)
    model_moves.measure_split_gains(model, room, particles, steps, two := np.zeros(2))
    assert two.max() < 4.0


@pytest.mark.slow
def test_a_single_particle_is_not_split(maps: Maps) -> None:
    model, room, particles, _ = one_of_two(maps, noisy(maps, np.zeros((1, 3)), even_light(1)), 1.0)
    left, size = model.left.copy(), pixel_mm(maps) / maps.half_mm
    split(model, room, particles, 0.7 * size * np.eye(3))
    assert particles.alive.tolist() == [True, False]
    assert_allclose(particles.position[0], 0.0, atol=1e-12)
    assert_allclose(model.left, left, atol=1e-3)


@pytest.mark.slow
def test_a_wide_particle_is_not_split(maps: Maps) -> None:
    """Two so near that no camera sees them apart are one with a wider image."""
    size = pixel_mm(maps) / maps.half_mm
    pair = 0.15 * size * np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]])
    images = noisy(maps, pair, np.full((2, 4), 50.0 * TYPICAL))
    model, room, particles, single = one_of_two(maps, images, 100.0)
    steps = 0.15 * size * np.ones((1, 3))
    model_moves.measure_split_gains(model, room, single, steps, gain := np.zeros(1))
    assert gain[0] > 100.0
    split(model, room, particles, steps)
    assert particles.alive.tolist() == [True, False]
