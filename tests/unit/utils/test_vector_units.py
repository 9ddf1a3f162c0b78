"""Kernels that compute in the lanes of vector units."""

from typing import Any

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.algorithms.particles.image_model import Sum
from sabench.utils import vector_units


@numba.njit
def _add(out: Any, left: Any, right: Any) -> None:
    vector_units.add_product(out, 1, left, 2, right, 0)


def test_a_product_of_matrices_is_added_to_one_of_many() -> None:
    """Other matrices stay as they are."""
    random = np.random.default_rng(1)
    out, left, right = (random.normal(size=(3, 4, 4)) for _ in range(3))
    expected = out.copy()
    expected[1] += left[2] @ right[0]
    _add(out, left, right)
    assert_allclose(out, expected, rtol=1e-14, atol=1e-14)


CAMERA, TOP, START, LIGHT = 1, 5, 9, np.float32(3.0)
ALL_PLAIN, ALL_SHAPED = (
    (vector_units.PLAIN, vector_units.PLAIN_BY_X, vector_units.PLAIN_BY_Y),
    (vector_units.SHAPED, vector_units.SHAPED_BY_X, vector_units.SHAPED_BY_Y),
)


def _at_the_window(kernel: Any) -> Any:
    @numba.njit
    def run(left: Any, weight: Any, profiles: Any, rows: int) -> Any:
        return kernel(left, weight, profiles, CAMERA, TOP, START, rows, LIGHT)

    return run


_match, _match_shaped, _sum, _sum_shaped = (
    _at_the_window(getattr(vector_units, name))
    for name in ("match_window", "match_shaped", "sum_window", "sum_shaped")
)


@pytest.fixture(params=[5, 7, 11])
def window(request: pytest.FixtureRequest) -> tuple[Any, Any, Any, int]:
    """Make images of two cameras, a fifth of them saturated, and profiles."""
    size, random = request.param, np.random.default_rng(request.param)
    left, weight = (random.normal(size=(2, 40, 48)).astype(np.float32) for _ in range(2))
    weight = np.where(random.random(weight.shape) < 0.2, -np.abs(weight), np.abs(weight))
    profiles = random.normal(
        size=(2, len(vector_units.Profile), vector_units.LANES * -(-size // vector_units.LANES))
    ).astype(np.float32)
    profiles[:, :, size:] = 0.0
    return left, weight, profiles, size


def _pixels(window: tuple[Any, Any, Any, int]) -> tuple[Any, Any]:
    left, weight, profiles, size = window
    part = CAMERA, slice(TOP, TOP + size), slice(START, START + profiles.shape[2])
    return left[part].astype(float), weight[part].astype(float)


def _image(window: tuple[Any, Any, Any, int], pairs: vector_units.Pairs) -> Any:
    *_, profiles, size = window
    own = profiles[CAMERA].astype(float)
    return np.sum([np.outer(own[down, :size], own[across]) for across, down in pairs], axis=0)


def _spared(weight: Any, counts: Any, light: Any) -> float:
    return float(np.sum(0.5 * (np.abs(weight) - counts) * np.maximum(light, 0.0) ** 2))


@pytest.mark.parametrize(("match", "pairs"), [(_match, ALL_PLAIN), (_match_shaped, ALL_SHAPED)])
def test_matches_are_numpys(window: tuple[Any, Any, Any, int], match: Any, pairs: Any) -> None:
    """Saturated pixels count where the light is not enough."""
    left, weight = _pixels(window)
    own = _image(window, pairs[0])
    counts = np.where((weight >= 0.0) | (left > LIGHT * own), np.abs(weight), 0.0)
    expected = np.sum(counts * own * left), np.sum(counts * own**2), _spared(weight, counts, left)
    assert_allclose(match(*window), expected, rtol=2e-5, atol=2e-4)


@pytest.mark.parametrize(("add", "pairs"), [(_sum, ALL_PLAIN), (_sum_shaped, ALL_SHAPED)])
def test_sums_are_numpys(window: tuple[Any, Any, Any, int], add: Any, pairs: Any) -> None:
    left, weight = _pixels(window)
    own, along_x, along_y = (_image(window, each) for each in pairs)
    counts = np.where((weight >= 0.0) | (left > 0.0), np.abs(weight), 0.0)
    expected = {
        Sum.WEIGHT: counts * own**2,
        Sum.PULL: counts * own * left,
        Sum.XX: counts * along_x**2,
        Sum.XY: counts * along_x * along_y,
        Sum.YY: counts * along_y**2,
        Sum.X: counts * along_x * left,
        Sum.Y: counts * along_y * left,
    }
    found = add(*window)
    for place, terms in expected.items():
        assert_allclose(found[place], terms.sum(), rtol=2e-5, atol=5e-4)
    assert_allclose(found[Sum.GIVEN], _spared(weight, counts, left + LIGHT * own), rtol=2e-5)
