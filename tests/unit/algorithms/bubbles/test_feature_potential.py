"""Darkness, feature potentials and transmission against their definitions."""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.bubbles.backlit_images import transmission
from sabench.algorithms.bubbles.features import WINDOW, compute_potential, darkness
from sabench.algorithms.bubbles.search import _sample
from sabench.api import Observation
from sabench.simulation.in_memory import simulate
from tests.helpers.particle_scenes import make_scene


@pytest.fixture(scope="module")
def observation() -> Observation:
    return simulate(make_scene(), backend="splat").observation


def test_darkness_is_equation_5_7(
    observation: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Equation 5.7 with n = 1/3, at voxels that all cameras see."""
    dark = np.linspace(0.5, 0.9, len(observation.images), dtype=np.float32)
    light = np.ones(observation.images.shape, np.float32) - dark[:, None, None]
    module = sys.modules[darkness.__module__]  # its name in the package is a function
    monkeypatch.setattr(module, "transmission", lambda case: light)
    volume = darkness(observation)
    middle = tuple(size // 2 for size in volume.shape)
    assert volume[middle] == pytest.approx(np.prod(dark) ** (1.0 / 3.0), rel=1e-4)


@pytest.mark.parametrize("step", [3, 5])
def test_the_feature_potential_is_that_of_the_equations(step: int) -> None:
    """Equations 5.15 and 5.16: gradients over the window's spread, both directions."""
    volume = np.random.default_rng(4).normal(0.5, 0.2, (4, 16, 21)).astype(np.float32)
    volume[:, :8, :8] = 0.4
    padded = np.pad(volume.astype(np.float64), ((0, 0), (1, 1), (1, 1)), mode="edge")
    across = np.abs(padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]) / 2.0
    along = np.abs(padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]) / 2.0
    potential = compute_potential(volume, step)
    assert potential.shape == (4, (16 - WINDOW) // step + 1, (21 - WINDOW) // step + 1)
    for _, row, column in np.ndindex(1, *potential.shape[1:]):
        part = np.s_[:, row * step : row * step + WINDOW, column * step : column * step + WINDOW]
        spread = volume[part].astype(np.float64).std()
        expected = np.zeros(4)
        if spread >= 0.02:
            both = [gradient[part] / spread for gradient in (across, along)]
            sums = [(each * np.exp(each / 2.0)).sum(axis=(1, 2)) for each in both]
            expected = np.maximum(*sums)
        assert_allclose(potential[:, row, column], expected, rtol=1e-4)


def test_transmission_takes_an_uneven_diffuser_out(observation: Observation) -> None:
    """Images wider than high; a dark disc before a diffuser that is brighter on the right."""
    rows, columns = np.mgrid[0:110, 0:170]
    diffuser = 2000.0 + columns
    apart = np.hypot(columns - 90, rows - 50)
    light = diffuser * np.where(apart < 20, 0.3, 1.0) + observation.black_dn
    images = np.repeat(np.rint(light)[None], 4, axis=0).astype(np.uint16)
    found = transmission(replace(observation, images=images))
    assert_allclose(found[0][apart < 15], 0.3, atol=0.02)
    assert_allclose(found[0][apart > 25], 1.0, atol=0.03)
    assert_array_equal(found[0], found[3])


def test_votes_are_sampled_at_their_pixel_and_radius() -> None:
    maps: Any = np.random.default_rng(1).random((5, 7, 9)).astype(np.float32)
    pixels = np.array([[3.4, 5.6], [8.4, 0.2], [9.0, 2.0], [2.0, 3.0], [5.0, -0.6]])
    size, first, step = np.exp([0.35, -1.0, 0.5, 0.5, 0.5]), 0.1, 0.2
    out = np.full(5, np.nan, dtype=np.float32)
    good = np.array([True, True, True, False, True])
    _sample(slice(0, len(out)), maps, pixels, good, size, first, step, out)
    expected = 0.75 * maps[1, 6, 3] + 0.25 * maps[2, 6, 3]  # (0.35 - 0.1) / 0.2 = 1.25
    assert out[0] == pytest.approx(expected, rel=1e-5)
    assert out[1] == pytest.approx(maps[0, 0, 8])  # smaller than the smallest radius
    assert np.isnan(out[2:]).all()
