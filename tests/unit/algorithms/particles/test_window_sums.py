"""Sums over windows against the same in numpy, with saturated pixels and windows of two blocks."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from sabench.algorithms.particles.image_model import GIVEN, PULL, WEIGHT, XX, XY, YY, X, Y
from sabench.algorithms.particles.window_sums import match_window, sum_window
from sabench.utils.vector_units import LANES

CAMERA, TOP, START, LIGHT = 1, 5, 9, np.float32(3.0)


@numba.njit
def _match(*arrays: Any) -> Any:
    left, weight, x, y, rows = arrays
    return match_window(left, weight, x, y, 1, 5, 9, rows, np.float32(3.0))


@numba.njit
def _sum(*arrays: Any) -> Any:
    left, weight, x, by_x, y, by_y, rows = arrays
    return sum_window(left, weight, x, by_x, y, by_y, 1, 5, 9, rows, np.float32(3.0))


@pytest.fixture(params=[5, 7, 11])
def window(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Make images of two cameras, a fifth of them saturated, and profiles."""
    size, random = request.param, np.random.default_rng(request.param)
    lanes = LANES * -(-size // LANES)
    left, weight = (random.normal(size=(2, 40, 48)).astype(np.float32) for _ in range(2))
    weight = np.where(random.random(weight.shape) < 0.2, -np.abs(weight), np.abs(weight))
    profiles = random.normal(size=(4, 2, lanes)).astype(np.float32)
    profiles[:, :, size:] = 0.0
    x, by_x, y, by_y = profiles
    return {
        "left": left, "weight": weight, "x": x, "by_x": by_x, "y": y, "by_y": by_y, "size": size
    }  # fmt: skip


def _pixels(window: dict[str, Any]) -> tuple[Any, Any]:
    part = CAMERA, slice(TOP, TOP + window["size"]), slice(START, START + window["x"].shape[1])
    return window["left"][part].astype(float), window["weight"][part].astype(float)


def _image(window: dict[str, Any], across: str, down: str) -> Any:
    rows = window[down][CAMERA, : window["size"]].astype(float)
    return np.outer(rows, window[across][CAMERA])


def _spared(weight: Any, counts: Any, light: Any) -> float:
    return float(np.sum(0.5 * (np.abs(weight) - counts) * np.maximum(light, 0.0) ** 2))


def test_a_window_is_matched_as_in_numpy(window: dict[str, Any]) -> None:
    """Saturated pixels count where the light is not enough."""
    left, weight = _pixels(window)
    own = _image(window, "x", "y")
    counts = np.where((weight >= 0.0) | (left > LIGHT * own), np.abs(weight), 0.0)
    expected = np.sum(counts * own * left), np.sum(counts * own**2), _spared(weight, counts, left)
    found = _match(*(window[name] for name in ("left", "weight", "x", "y", "size")))
    np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-5)


def test_a_window_is_summed_up_as_in_numpy(window: dict[str, Any]) -> None:
    """All sums stand where their names say."""
    left, weight = _pixels(window)
    own, along_x, along_y = (
        _image(window, across, down) for across, down in (("x", "y"), ("by_x", "y"), ("x", "by_y"))
    )
    counts = np.where((weight >= 0.0) | (left > 0.0), np.abs(weight), 0.0)
    expected = {
        WEIGHT: counts * own**2,
        PULL: counts * own * left,
        XX: counts * along_x**2,
        XY: counts * along_x * along_y,
        YY: counts * along_y**2,
        X: counts * along_x * left,
        Y: counts * along_y * left,
    }
    names = "left", "weight", "x", "by_x", "y", "by_y", "size"
    found = _sum(*(window[name] for name in names))
    for place, terms in expected.items():
        np.testing.assert_allclose(found[place], terms.sum(), rtol=2e-5, atol=2e-4)
    given = _spared(weight, counts, left + LIGHT * own)
    np.testing.assert_allclose(found[GIVEN], given, rtol=2e-5)
