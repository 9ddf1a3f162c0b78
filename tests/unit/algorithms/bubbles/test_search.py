"""Outlines and bubbles in images that hold few of them, or none."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.bubbles.features import find_outlines
from sabench.algorithms.bubbles.rim_fit import start_of
from sabench.algorithms.bubbles.search import Hypotheses, Limits, search_bubbles
from tests.helpers.particle_box import CAMERAS
from tests.unit.algorithms.bubbles.test_rim_fit import PROFILE, SHAPE, model_of

LIMITS = Limits(0.2, 4.5, 0.5)


@pytest.mark.parametrize(
    ("column", "row", "radius"), [(47.3, 31.6, 12.0), (60.2, 50.7, 2.5), (3.0, 62.0, 2.0)]
)
def test_an_outline_is_where_the_disc_is(column: float, row: float, radius: float) -> None:
    y, x = np.mgrid[0:70, 0:90]
    apart = radius - np.hypot(x - column, y - row)
    disc = np.clip(0.5 + apart / 2.0, 0.0, 1.0).astype(np.float32)
    found = find_outlines(disc, np.full((70, 90), 7.0, np.float32), 0.3, 10.0)
    (x, y, a, b), (depth,) = found.shapes[0], found.depth
    assert (x, y) == pytest.approx((column, row), abs=0.25)
    assert (a, b) == pytest.approx((radius, radius), abs=0.8)  # a threshold at the mean
    assert depth == pytest.approx(7.0)


def test_two_bubbles_are_found_and_a_third_is_not_invented() -> None:
    true = np.array([[0.5, -0.4, 36.0], [-0.9, 0.3, 37.5]])
    images = model_of(start_of(true[0], 0.8), start_of(true[1], 0.6)).images
    guess = np.vstack([true + np.array([0.05, -0.05, 0.1]), [[-3.0, 2.5, 34.0]]])
    start = Hypotheses(guess, np.array([0.75, 0.65, 0.7]), np.array([0.9, 0.8, 0.7]), np.ones(3))
    found = search_bubbles(images, CAMERAS, lambda half_angle: PROFILE, 0.4, start, LIMITS, 1)
    order = np.argsort(-found.radius_mm)
    assert_allclose(found.center_mm[order], true, atol=0.03)
    assert_allclose(found.radius_mm[order], [0.8, 0.6], rtol=0.02)


def test_what_is_left_of_a_shadow_is_no_bubble() -> None:
    true = np.array([0.5, -0.4, 36.0])
    images = model_of(start_of(true, 0.3)).images
    start = Hypotheses(true[None] + 0.02, np.array([0.32]), np.array([0.9]), np.ones(1))
    counts = [
        len(search_bubbles(images, CAMERAS, lambda angle: PROFILE, 0.4, start, limits, 1).center_mm)
        for limits in (LIMITS, Limits(0.35, 4.5, 0.5), Limits(0.1, 0.25, 0.5))
    ]
    assert counts == [1, 0, 0]
    nothing = Hypotheses(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0))
    light = np.ones(SHAPE, np.float32)
    found = search_bubbles(light, CAMERAS, lambda angle: PROFILE, None, nothing, LIMITS, 1)
    assert found.center_mm.shape == (0, 3)
