"""Images of particles that are no plain Gaussians, and claimed errors of positions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from sabench.algorithms.particles import image_model
from sabench.algorithms.particles.claimed_errors import claimed_covariances
from sabench.utils.arrays import F64
from sabench.utils.vector_units import SHAPED_BY_X, SHAPED_BY_Y
from tests.helpers.image_model import SIGMA, model_of, particles_of, room_of
from tests.helpers.particle_box import COLUMNS, ROWS, Maps

CAMERA, PLACE, FINE = 1, np.array([0.3, -0.2, 0.4]), 20
# of the covariance, px2, and flatness over the box
CHANGE = np.array([[0.0, 0.02, -0.03, 0.01, 0.02], [0.0, 0.005, 0.002, -0.01, 0.01]])


def shaped(
    maps: Maps, correlation: float, flatness: float = 0.0
) -> tuple[image_model.ImageModel, image_model.Room]:
    """Make a model of dark images, with one camera whose images are shaped so where `PLACE` is."""
    model, room = model_of(maps, np.zeros((4, ROWS, COLUMNS))), room_of(maps)
    shape = model.shapes[CAMERA, 2:]
    for k, there in enumerate((correlation * SIGMA[0] * SIGMA[1], flatness)):
        if there:
            shape[k] = CHANGE[k]
            shape[k, 0] = there - CHANGE[k, 1:] @ [*PLACE, PLACE[2] ** 2]
    return model, room


def image_of(model: image_model.ImageModel, room: image_model.Room, position: F64) -> F64:
    image_model.place_windows(model, room, position)
    image_model.fill_image(model, room, CAMERA, image := np.zeros((room.window, room.window)))
    return image


def points_in_pixels(room: image_model.Room) -> F64:
    """Places (row, column, 2) as (column, row) within pixels of the window, px."""
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    corner = room.corner[CAMERA] - image_model.MARGIN_PX
    column, row = ((at + np.arange(room.window)[:, None] + fine).ravel() for at in corner)
    return np.stack(np.meshgrid(column, row), axis=-1)


def over_pixels(shown: F64, room: image_model.Room) -> F64:
    return np.asarray(shown.reshape(room.window, FINE, room.window, FINE).mean(axis=(1, 3)))


@pytest.mark.slow_but_first
@pytest.mark.parametrize(("correlation", "share"), [(0.1, 0.001), (0.3, 0.01), (-0.3, 0.01)])
def test_an_image_integrates_a_tilted_gaussian(
    maps: Maps, correlation: float, share: float
) -> None:
    """To a share of the peak; without the tilt, it would be off by far more."""
    model, room = shaped(maps, correlation)
    found = image_of(model, room, PLACE)
    covariance = correlation * SIGMA[0] * SIGMA[1]
    gaussian = multivariate_normal(
        room.here[CAMERA], [[SIGMA[0] ** 2, covariance], [covariance, SIGMA[1] ** 2]]
    )
    expected = over_pixels(gaussian.pdf(points_in_pixels(room)), room)
    assert_allclose(found, expected, atol=share * expected.max())
    upright = image_of(*shaped(maps, 0.0), PLACE)
    assert np.abs(upright - expected).max() > 5.0 * share * expected.max()


@pytest.mark.parametrize("flatness", [0.01, 0.05])
def test_a_flat_image_is_a_gaussian_times_a_polynomial(maps: Maps, flatness: float) -> None:
    model, room = shaped(maps, 0.0, flatness)
    found = image_of(model, room, PLACE)
    u = (((points_in_pixels(room) - room.here[CAMERA]) / SIGMA) ** 2).sum(axis=2)
    shown = np.exp(-0.5 * u) * (1.0 - flatness * (u**2 - 8.0 * u + 8.0))
    expected = over_pixels(shown, room) / (2.0 * np.pi * SIGMA[0] * SIGMA[1])
    assert_allclose(found, expected, atol=2e-3 * expected.max())
    plain = image_of(*shaped(maps, 0.0), PLACE)
    assert found.max() < (1.0 - 3.0 * flatness) * plain.max()


@pytest.mark.parametrize(("flatness", "as_if"), [(-0.01, 0.0), (0.1, image_model.MOST_FLAT)])
def test_flatness_is_limited(maps: Maps, flatness: float, as_if: float) -> None:
    model, room = shaped(maps, 0.0)
    model.shapes[CAMERA, 3, 0] = flatness
    one = image_of(model, room, PLACE)
    model.shapes[CAMERA, 3, 0] = as_if
    assert_allclose(one, image_of(model, room, PLACE), atol=1e-7)


@pytest.mark.parametrize(("correlation", "flatness"), [(0.3, 0.0), (0.0, 0.05), (-0.2, 0.05)])
def test_slopes_are_the_images(maps: Maps, correlation: float, flatness: float) -> None:
    """Against differences of images; the shape's own change is left out."""
    model, room = shaped(maps, correlation, flatness)
    step = 1e-3
    image_model.place_windows(model, room, PLACE)
    rows = room.profiles[CAMERA, :, : room.window]
    by_x, by_y = (
        sum(np.outer(rows[down], rows[across]) for across, down in pairs)
        for pairs in (SHAPED_BY_X, SHAPED_BY_Y)
    )
    for axis in range(3):
        along = room.slope[CAMERA, :, axis].copy()
        moved = [image_of(model, room, PLACE + sign * step * np.eye(3)[axis]) for sign in (-1, 1)]
        image_model.place_windows(model, room, PLACE)
        expected = (moved[1] - moved[0]) / (2.0 * step)
        found = along[0] * by_x + along[1] * by_y
        assert np.abs(found - expected).max() < 0.005 * np.abs(expected).max()


def test_what_is_painted_is_the_image(maps: Maps) -> None:
    model, room = shaped(maps, 0.3, 0.04)
    light = np.array([10.0, 20.0, 30.0, 40.0])
    image_model.place_windows(model, room, PLACE)
    image_model.paint_here(model, room, light, 1.0)
    expected = light[CAMERA] * image_of(model, room, PLACE)
    column, row = room.corner[CAMERA]
    shown = model.left[CAMERA, row : row + room.window, column : column + room.window]
    assert_allclose(shown, expected, rtol=1e-5, atol=1e-5)
    assert model.left[CAMERA].sum() == pytest.approx(expected.sum(), rel=1e-5)


WIDTHS, POINT, LIGHT, NOISE = ((1.2, 1.5), np.array([0.2, -0.1, 0.3]), 300.0, 2.0)
STEP = 1e-3


def all_images(model: image_model.ImageModel, position: F64) -> F64:
    """Images (camera, pixel) of a particle, where its windows lie."""
    room = image_model.make_room(np.tile(WIDTHS, (4, 1)))
    shown = np.zeros((4, ROWS, COLUMNS))
    image_model.place_windows(model, room, position)
    for camera in range(4):
        image_model.fill_image(model, room, camera, image := np.zeros((room.window, room.window)))
        column, row = room.corner[camera] - image_model.MARGIN_PX
        shown[camera, row : row + room.window, column : column + room.window] = image
    return LIGHT * shown.reshape(4, -1)


@pytest.mark.slow_but_first
@pytest.mark.parametrize(("correlation", "flatness"), [(0.0, 0.0), (-0.4, 0.0), (0.3, 0.03)])
def test_a_claim_is_the_bound_of_the_shape(maps: Maps, correlation: float, flatness: float) -> None:
    """With ellipses of which one axis is a quarter longer, as they are or aslant."""
    model = model_of(maps, np.zeros((4, ROWS, COLUMNS)))
    model.shapes[:, :2, 0] = WIDTHS
    model.shapes[:, 2, 0], model.shapes[:, 3, 0] = (correlation * WIDTHS[0] * WIDTHS[1], flatness)
    slopes = [all_images(model, POINT)]
    for axis in STEP * np.eye(3):
        ends = all_images(model, POINT + axis) - all_images(model, POINT - axis)
        slopes.append(ends / (2.0 * STEP))
    columns = np.stack([one.ravel() for one in slopes], axis=1)
    bound = np.linalg.inv(columns.T @ columns / NOISE**2)[1:, 1:]
    expected = bound * np.outer(maps.half_mm, maps.half_mm)
    particles = particles_of(POINT[None], np.full((1, 4), LIGHT))
    model.left[:] = 0.0
    found = claimed_covariances(model, particles, np.full(4, NOISE))[0]
    ratio = np.linalg.eigvals(np.linalg.solve(expected, found)).real
    assert ratio == pytest.approx(np.ones(3), abs=0.1)
