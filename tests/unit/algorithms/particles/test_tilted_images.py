"""Images whose columns and rows are correlated, next to integrals of the Gaussian over pixels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sabench.algorithms.particles.image_model import (
    MARGIN,
    ImageModel,
    Room,
    fill_image,
    fill_slopes,
    paint_here,
    place,
)
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64
from tests.helpers.image_model import SIGMA, model_of, room_of
from tests.unit.algorithms.particles.test_triangulation import COLUMNS, ROWS, maps

__all__ = ["maps"]

CAMERA, PLACE = 1, np.array([0.3, -0.2, 0.4])
CHANGE = np.array([0.0, 0.02, -0.03, 0.01])  # of the covariance over the box, px2


def tilted(maps: VolumePolynomials, correlation: float) -> tuple[ImageModel, Room]:
    """Make a model of dark images, with one camera whose images are tilted where `PLACE` is."""
    model, room = model_of(maps, np.zeros((4, ROWS, COLUMNS))), room_of(maps)
    covariance = correlation * SIGMA[0] * SIGMA[1]
    model.shapes[CAMERA, 2] = CHANGE
    model.shapes[CAMERA, 2, 0] = covariance - CHANGE[1:] @ PLACE
    return model, room


def image_of(model: ImageModel, room: Room, position: F64) -> F64:
    """Fill in the image (row, column) of a particle in the tilted camera."""
    place(model, room, position)
    fill_image(model, room, CAMERA, image := np.zeros((room.window, room.window)))
    return image


@pytest.mark.parametrize(("correlation", "share"), [(0.1, 0.001), (0.3, 0.01), (-0.3, 0.01)])
def test_an_image_is_the_integral_of_a_tilted_gaussian(
    maps: VolumePolynomials, correlation: float, share: float
) -> None:
    """To a share of the peak; without the tilt, it would be off by far more."""
    model, room = tilted(maps, correlation)
    found = image_of(model, room, PLACE)
    covariance = correlation * SIGMA[0] * SIGMA[1]
    gaussian = multivariate_normal(
        room.here[CAMERA], [[SIGMA[0] ** 2, covariance], [covariance, SIGMA[1] ** 2]]
    )
    fine = (np.arange(20) + 0.5) / 20.0 - 0.5  # of a pixel
    column, row = (
        (room.corner[CAMERA, k] - MARGIN + np.arange(room.window)[:, None] + fine).ravel()
        for k in range(2)
    )
    shown = gaussian.pdf(np.stack(np.meshgrid(column, row), axis=-1))
    expected = shown.reshape(room.window, 20, room.window, 20).mean(axis=(1, 3))
    np.testing.assert_allclose(found, expected, atol=share * expected.max())
    upright = image_of(*tilted(maps, 0.0), PLACE)
    assert np.abs(upright - expected).max() > 5.0 * share * expected.max()


@pytest.mark.parametrize(("correlation", "share"), [(0.1, 0.015), (0.3, 0.08)])
def test_slopes_are_the_images(maps: VolumePolynomials, correlation: float, share: float) -> None:
    """Against differences of images of particles that are moved in the box.

    Steps of fits need no more: third derivatives are left out, and the tilt's own change.
    """
    model, room = tilted(maps, correlation)
    step = 1e-3
    place(model, room, PLACE)
    by_x, by_y = np.zeros((2, room.window, room.window))
    fill_slopes(model, room, CAMERA, by_x, by_y)
    for axis in range(3):
        along = room.slope[CAMERA, :, axis].copy()
        moved = [image_of(model, room, PLACE + sign * step * np.eye(3)[axis]) for sign in (-1, 1)]
        place(model, room, PLACE)
        expected = (moved[1] - moved[0]) / (2.0 * step)
        found = along[0] * by_x + along[1] * by_y
        assert np.abs(found - expected).max() < share * np.abs(expected).max()


def test_what_is_painted_is_the_image(maps: VolumePolynomials) -> None:
    model, room = tilted(maps, 0.3)
    light = np.array([10.0, 20.0, 30.0, 40.0])
    place(model, room, PLACE)
    paint_here(model, room, light, 1.0)
    expected = light[CAMERA] * image_of(model, room, PLACE)
    column, row = room.corner[CAMERA]
    shown = model.left[CAMERA, row : row + room.window, column : column + room.window]
    np.testing.assert_allclose(shown, expected, rtol=1e-5, atol=1e-5)
    assert model.left[CAMERA].sum() == pytest.approx(expected.sum(), rel=1e-5)
