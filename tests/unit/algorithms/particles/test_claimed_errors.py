"""Claimed errors of single particles, next to the bound by differences of their images."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.algorithms.particles.claimed_errors import claimed_covariances
from sabench.algorithms.particles.image_model import (
    MARGIN_PX,
    ImageModel,
    fill_image,
    make_room,
    place_windows,
)
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64
from tests.helpers.image_model import model_of, particles_of
from tests.unit.algorithms.particles.test_matching import COLUMNS, ROWS, maps

__all__ = ["maps"]

SIGMA, PLACE, LIGHT, NOISE = (1.2, 1.5), np.array([0.2, -0.1, 0.3]), 300.0, 2.0
STEP = 1e-3


def all_images(model: ImageModel, position: F64) -> F64:
    """Images (camera, pixel) of a particle, where its windows lie."""
    room = make_room(np.tile(SIGMA, (4, 1)))
    shown = np.zeros((4, ROWS, COLUMNS))
    place_windows(model, room, position)
    for camera in range(4):
        fill_image(model, room, camera, image := np.zeros((room.window, room.window)))
        column, row = room.corner[camera] - MARGIN_PX
        shown[camera, row : row + room.window, column : column + room.window] = image
    return LIGHT * shown.reshape(4, -1)


@pytest.mark.parametrize(
    ("correlation", "flatness"), [(0.0, 0.0), (0.3, 0.0), (-0.4, 0.0), (0.0, 0.05), (0.3, 0.03)]
)
def test_a_claim_is_the_bound_of_the_shape(
    maps: VolumePolynomials, correlation: float, flatness: float
) -> None:
    """With ellipses of which one axis is a quarter longer, as they are or aslant."""
    model = model_of(maps, np.zeros((4, ROWS, COLUMNS)))
    model.shapes[:, :2, 0] = SIGMA
    model.shapes[:, 2, 0], model.shapes[:, 3, 0] = correlation * SIGMA[0] * SIGMA[1], flatness
    slopes = [all_images(model, PLACE)]
    for axis in STEP * np.eye(3):
        ends = all_images(model, PLACE + axis) - all_images(model, PLACE - axis)
        slopes.append(ends / (2.0 * STEP))
    columns = np.stack([one.ravel() for one in slopes], axis=1)
    bound = np.linalg.inv(columns.T @ columns / NOISE**2)[1:, 1:]
    expected = bound * np.outer(maps.half_mm, maps.half_mm)
    particles = particles_of(PLACE[None], np.full((1, 4), LIGHT))
    model.left[:] = 0.0
    widths = np.tile(SIGMA, (4, 1))
    found = claimed_covariances(model, widths, particles, np.full(4, NOISE))[0]
    ratio = np.linalg.eigvals(np.linalg.solve(expected, found)).real
    assert ratio == pytest.approx(np.ones(3), abs=0.1)
