"""Separation of three phases in drawn images."""

import numpy as np

from sabench.algorithms.bubbles import image_diameter_px, separate_phases
from sabench.api import Observation
from sabench.scenes import build_rig
from sabench.utils.arrays import F64, Bool
from tests.helpers.bubble_scenes import small

_DIFFUSER, _BLACK = 500.0, 64.0
_TRACERS = np.array([[20.0, 20.0], [130.0, 90.0], [40.0, 60.0]])  # the last before the body
_BUBBLE = np.array([110.0, 40.0])


def drawn(tracers: F64 = _TRACERS, noise: float = 10.0) -> tuple[Observation, Bool]:
    """A body, a bubble with a bright spot, and tracers, the same in all five cameras."""
    rig = build_rig(small(), "drawn")
    x, y = np.meshgrid(np.arange(160.0), np.arange(128.0))
    image = np.full(x.shape, _DIFFUSER)
    body = (np.abs(x - 40.0) <= 20.0) & (np.abs(y - 60.0) <= 40.0)
    image[body] = 10.0
    away = np.hypot(x - _BUBBLE[0], y - _BUBBLE[1])
    image[away < 10.0] = 20.0
    image[away < 2.5] = 0.95 * _DIFFUSER  # the image of the diffuser in the bubble
    for column, row in tracers:
        image += 900.0 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2.0 * 0.8**2))
    image += noise * np.random.default_rng(3).standard_normal(image.shape)
    images = np.repeat(np.rint(image + _BLACK).astype(np.uint16)[None], len(rig.cameras), axis=0)
    return Observation(images, rig.cameras, rig.grid, _BLACK, 4095.0), body


def test_three_phases_are_separated() -> None:
    """Tracers are peaks above the diffuser and before the body, which is wider than bubbles."""
    case, body = drawn()
    parts = separate_phases(case, 24.0)
    light, left = (p.images[0].astype(np.float64) - _BLACK for p in (parts.tracers, parts.bubbles))
    far = np.ones(light.shape, dtype=np.bool_)
    for column, row in _TRACERS.astype(int):
        assert light[row, column] > 350.0
        far[row - 12 : row + 13, column - 12 : column + 13] = False
    assert not light[far].any()  # neither the bubble's spot nor noise is a tracer
    assert left.max() < _DIFFUSER + 60.0
    assert abs(np.median(left[body]) / _DIFFUSER - 1.0) < 0.05
    x, y = _BUBBLE.astype(int)
    assert left[y, x + 6] < 0.2 * _DIFFUSER
    assert left[y, x] > 0.8 * _DIFFUSER
    found = parts.body[0]
    assert (found & body).sum() / (found | body).sum() > 0.93
    assert not separate_phases(case, 90.0).body.any()
    alone = separate_phases(drawn(np.zeros((0, 2)))[0], 24.0)
    assert not (alone.tracers.images > _BLACK).any()


def test_image_diameter_is_that_of_the_projection() -> None:
    case, _ = drawn()
    wide = image_diameter_px(case, 1.0)
    assert abs(image_diameter_px(case, 2.0) / wide - 2.0) < 0.02
    assert 5.0 < wide < 20.0
