"""Bounds of the stage that light meets."""

from __future__ import annotations

import numpy as np
import pytest

from sabench.api import Material
from sabench.api.truth import Bubbles, Solid
from sabench.utils import backend
from tests.unit.simulation.rendering.test_bubbles_traced import bubbles

ORIGIN = np.array([1.0, 2.0, 3.0])


def radius_of(what: Bubbles, solid: Solid | None = None) -> float:
    backend.mitsuba()
    from sabench.simulation.rendering.bubble_stage import _bounding_radius

    bodies = [] if solid is None else [(solid, Material())]
    return _bounding_radius(what, bodies, None, ORIGIN)


def test_the_ball_holds_everything_with_a_margin_of_a_percent_and_a_millimetre() -> None:
    small, far = [[1.3, 2.0, 3.0]], [[1.3, 2.0, 3.0], [1.0, 12.0, 3.0]]
    body = Solid(
        np.array([[1.0, 2.0, 3.4], [1.1, 2.0, 3.0], [1.0, 2.1, 3.0]]), np.array([[0, 1, 2]])
    )
    assert radius_of(bubbles(small, [[0.2, 0.1, 0.1]])) == pytest.approx(1.01 * 0.5 + 1.0)
    assert radius_of(bubbles(far, [[0.2] * 3, [0.1, 0.4, 0.1]])) == pytest.approx(1.01 * 10.4 + 1.0)
    assert radius_of(bubbles([], []), body) == pytest.approx(1.01 * 0.4 + 1.0)
