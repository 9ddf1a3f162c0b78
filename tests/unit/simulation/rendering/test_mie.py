"""Mie's series against miepython's, against its own integral and against Rayleigh's limit."""

from __future__ import annotations

import miepython
import numpy as np
import pytest

from sabench.simulation.rendering.scattering import (
    extinction_efficiency,
    intensities,
    scaled_coefficients,
)

GLASS, LOSSY, BUBBLE = 1.59 / 1.333, (1.59 - 0.01j) / 1.333, 1.0 / 1.333


@pytest.mark.parametrize("index", [GLASS, LOSSY, BUBBLE])
def test_amplitudes_and_extinction_are_miepython_s(index: complex) -> None:
    sizes, angles = np.array([0.05, 3.0, 40.3, 158.1, 402.7]), np.linspace(0.02, 3.1, 41)
    found, extinction = intensities(index, sizes, angles), extinction_efficiency(index, sizes)
    for i, size in enumerate(sizes):
        pair = miepython.S1_S2(index, size, np.cos(angles), norm="wiscombe")
        for got, amplitude in zip(found, pair, strict=True):
            scale = np.abs(amplitude).max() ** 2
            expected = np.abs(amplitude) ** 2
            np.testing.assert_allclose(got[i], expected, rtol=1e-8, atol=1e-12 * scale)
        expected = miepython.efficiencies_mx(index, size)[0]
        assert extinction[i] == pytest.approx(expected, rel=1e-6)


def test_resonances_are_as_sharp_as_they_are() -> None:
    """A recurrence that starts too low smears them: order 411 at 400, by 60 digits (mpmath)."""
    scale = (2 * 411 + 1) / (411 * 412)
    b = scaled_coefficients(GLASS, np.array([400.0]))[1][0, 410] / scale
    assert abs(b) == pytest.approx(0.8417576717845643, rel=1e-12)


def test_many_sizes_and_angles_are_those_of_each() -> None:
    rng = np.random.default_rng(1)
    sizes, angles = rng.uniform(5.0, 60.0, 700), np.linspace(-0.3, 3.0, 2100)
    together = intensities(GLASS, sizes, angles)
    for i, j in ((0, 0), (511, 2047), (512, 2048), (699, 2099)):
        alone = intensities(GLASS, sizes[[i]], angles[[j]])
        for whole, one in zip(together, alone, strict=True):
            assert whole[i, j] == pytest.approx(one[0, 0], rel=1e-9)


@pytest.mark.parametrize("index", [GLASS, 1.33 - 0.02j, BUBBLE])
@pytest.mark.parametrize("size", [0.8, 8.0, 160.0])
def test_scattering_adds_up_to_the_cross_section(index: complex, size: float) -> None:
    cosines, weights = np.polynomial.legendre.leggauss(800)
    across, along = intensities(index, np.array([size]), np.arccos(cosines))
    scattered = (across + along)[0] @ weights / size**2  # Bohren and Huffman, eq. 4.61
    assert scattered == pytest.approx(miepython.efficiencies_mx(index, size)[1], rel=1e-6)


def test_small_particles_scatter_as_rayleighs() -> None:
    size, angles = 0.01, np.linspace(0.1, 3.0, 9)
    across, along = intensities(GLASS, np.array([size]), angles)
    strength = (size**3 * (GLASS**2 - 1.0) / (GLASS**2 + 2.0)) ** 2
    np.testing.assert_allclose(across[0], strength, rtol=1e-3)
    np.testing.assert_allclose(along[0], strength * np.cos(angles) ** 2, rtol=1e-3)


def test_both_signs_of_absorption_mean_the_same_loss() -> None:
    size, angles = np.array([60.0]), np.linspace(1.0, 1.2, 9)
    lossy, other, clear = (
        np.stack(intensities(index / 1.333, size, angles))
        for index in (1.45 - 0.05j, 1.45 + 0.05j, 1.45 + 0j)
    )
    np.testing.assert_array_equal(lossy, other)
    assert np.abs(lossy / clear - 1.0).max() > 0.1
