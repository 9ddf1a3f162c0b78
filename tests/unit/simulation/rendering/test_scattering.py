"""Scattering by small spheres: the theory of Mie, and shares of a pulse."""

import miepython
import numpy as np
import pytest

from sabench.simulation.rendering.particle_light import (
    Scattering,
    extinction_efficiency,
    intensities,
    scaled_coefficients,
)
from sabench.utils.arrays import F64
from sabench.worlds.tracers import lattice_diameters_mm, size_numbers

WAVENUMBER = 2.0 * np.pi * 1.333 / 532e-6
SIDEWAYS = (np.deg2rad(58.0), np.deg2rad(122.0))


def on_lattice(diameters_mm: F64) -> F64:
    return lattice_diameters_mm(size_numbers(diameters_mm))


def direct(diameters: F64, angles: F64, half: float, in_plane: F64) -> F64:
    """Sum the series at many chords of the aperture."""
    turns = np.arange(1, 102) * np.pi / 102
    weights = np.sin(turns) ** 2 / (np.sin(turns) ** 2).sum()
    out = []
    for d, angle, share in zip(diameters, angles, in_plane, strict=True):
        size = np.array([WAVENUMBER * d / 2.0])
        across, along = intensities(1.59 / 1.333, size, angle + half * np.cos(turns))
        out.append(weights @ ((1.0 - share) * across[0] + share * along[0]) / WAVENUMBER**2)
    return np.array(out)


@pytest.mark.slow_but_first
@pytest.mark.parametrize(("median", "spread"), [(0.02, 0.3), (0.05, 0.1), (0.002, 0.3)])
@pytest.mark.parametrize("half", [0.0, 0.0025, 0.02])
def test_single_particles_scatter_by_series(median: float, spread: float, half: float) -> None:
    rng = np.random.default_rng(1)
    diameters = on_lattice(median * np.exp(spread * rng.standard_normal(60)))
    angles, in_plane = np.deg2rad(rng.uniform(60.0, 120.0, 60)), rng.random(60)
    table = Scattering(1.59, 1.333, 532.0, SIDEWAYS)
    found = table.cross_section(diameters, angles, np.full(60, half), in_plane)
    ratio = found / direct(diameters, angles, half, in_plane)
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 2e-3


def test_a_particle_scatters_alike_whatever_else_there_is() -> None:
    rng = np.random.default_rng(2)
    diameters = on_lattice(rng.uniform(0.005, 0.05, 300))
    angles, half, share = rng.uniform(1.1, 2.0, 300), np.full(300, 0.004), np.full(300, 0.5)
    together = Scattering(1.59, 1.333, 532.0, SIDEWAYS)
    whole = together.cross_section(diameters, angles, half, share)
    for i in (0, 17, 299):
        one = slice(i, i + 1)
        alone = Scattering(1.59, 1.333, 532.0, (angles[i] - 0.1, angles[i] + 0.1))
        found = alone.cross_section(diameters[one], angles[one], half[one], share[one])
        assert found[0] == pytest.approx(whole[i], rel=1e-6)
    again = together.cross_section(diameters[:5], angles[:5], half[:5], share[:5])
    np.testing.assert_array_equal(again, whole[:5])


def test_the_aperture_s_mean_is_over_a_disc() -> None:
    half, rng = 0.012, np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (200_000, 2))
    across = points[np.hypot(*points.T) < 1.0, 0] * half
    table, size = Scattering(1.59, 1.333, 532.0, SIDEWAYS), on_lattice(np.array([0.03]))
    sizes, share = np.full(len(across), size[0]), np.full(len(across), 0.5)
    for angle in (1.3, 1.5, 1.75):
        each = table.cross_section(sizes, angle + across, 0.0 * across, share)
        mean = table.cross_section(size, np.array([angle]), np.array([half]), np.array([0.5]))
        assert mean[0] == pytest.approx(each.mean(), rel=0.01)


def test_forward_and_backward_light_are_in_reach() -> None:
    table = Scattering(1.59, 1.333, 532.0, (0.0, np.pi))
    angles, size = np.array([0.0, 0.001, np.pi - 0.001, np.pi]), on_lattice(np.full(4, 0.02))
    found = table.cross_section(size, angles, np.full(4, 0.001), np.full(4, 0.5))
    np.testing.assert_allclose(found, direct(size, angles, 0.001, np.full(4, 0.5)), rtol=2e-3)


@pytest.mark.slow
def test_tables_grow_where_other_angles_occur() -> None:
    """Outside its range the table is not extrapolated, and what it held stays the same."""
    rng = np.random.default_rng(5)
    diameters, share, half = on_lattice(rng.uniform(0.01, 0.04, 40)), np.full(40, 0.5), 0.004
    table = Scattering(1.59, 1.333, 532.0, (1.5, 1.6))
    inside = rng.uniform(1.51, 1.59, 40)
    before = table.cross_section(diameters, inside, np.full(40, half), share)
    beyond = rng.uniform(0.2, 3.0, 40)
    found = table.cross_section(diameters, beyond, np.full(40, half), share)
    np.testing.assert_allclose(found, direct(diameters, beyond, half, share), rtol=5e-3)
    again = table.cross_section(diameters, inside, np.full(40, half), share)
    np.testing.assert_allclose(again, before, rtol=1e-12)


def test_light_that_does_not_arrive_is_none() -> None:
    table, sizes = Scattering(1.59, 1.333, 532.0, SIDEWAYS), on_lattice(np.full(3, 0.02))
    angles, half = np.array([1.5, np.nan, 1.5]), np.array([0.01, 0.01, np.nan])
    found = table.cross_section(sizes, angles, half, np.full(3, 0.5))
    assert found[0] > 0.0
    np.testing.assert_array_equal(found[1:], 0.0)


def test_the_lattice_is_finer_than_anybody_measures() -> None:
    diameters = np.random.default_rng(4).uniform(1e-4, 0.3, 1000)
    rounded = on_lattice(diameters)
    assert np.abs(rounded / diameters - 1.0).max() < 2e-4
    np.testing.assert_array_equal(on_lattice(rounded), rounded)


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
    sizes, angles = np.random.default_rng(1).uniform(5.0, 60.0, 700), np.linspace(-0.3, 3.0, 2100)
    together = intensities(GLASS, sizes, angles)
    for i, j in ((0, 0), (511, 2047), (512, 2048), (699, 2099)):
        for whole, one in zip(together, intensities(GLASS, sizes[[i]], angles[[j]]), strict=True):
            assert whole[i, j] == pytest.approx(one[0, 0], rel=1e-9)


def test_both_signs_of_absorption_mean_the_same_loss() -> None:
    size, angles = np.array([60.0]), np.linspace(1.0, 1.2, 9)
    lossy, other, clear = (
        np.stack(intensities(index / 1.333, size, angles))
        for index in (1.45 - 0.05j, 1.45 + 0.05j, 1.45 + 0j)
    )
    np.testing.assert_array_equal(lossy, other)
    assert np.abs(lossy / clear - 1.0).max() > 0.1
