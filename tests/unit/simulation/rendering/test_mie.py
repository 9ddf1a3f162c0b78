"""Mie scattering against its own integral, the laser sheet against its energy."""

from __future__ import annotations

import math

import miepython
import numpy as np
import pytest

from sabench.scenes.illumination import Illumination
from sabench.simulation.rendering.laser_sheet import LIGHT_M_S, PLANCK_J_S, fluence
from sabench.simulation.rendering.mie import MieTable, mie_table

WAVELENGTH_MM = 532e-6


def over_the_sphere(table: MieTable) -> float:
    angles = np.append(table.angles_rad[table.angles_rad < np.pi], np.pi)
    values = np.interp(angles, table.angles_rad, table.per_square_diameter)
    return float(2.0 * np.pi * np.trapezoid(values * np.sin(angles), angles))


@pytest.mark.parametrize(
    ("index", "fluid", "diameter_mm"),
    [
        (index, fluid, diameter_mm)
        for index, fluid in ((1.59 + 0j, 1.333), (1.33 - 0.02j, 1.0), (1.0 + 0j, 1.333))
        for diameter_mm in (1e-4, 1e-3, 5e-3, 2e-2)
    ]
    + [(1.59 + 0j, 1.333, 5e-2)],  # series and angles cost the most here: once is enough
)
def test_scattering_adds_up_to_the_cross_section(
    index: complex, fluid: float, diameter_mm: float
) -> None:
    table = mie_table(np.array([diameter_mm]), index, fluid, 532.0, (0.0, np.pi))
    efficiency = miepython.efficiencies_mx(
        index / fluid, np.pi * diameter_mm * fluid / WAVELENGTH_MM
    )[1]
    assert over_the_sphere(table) == pytest.approx(efficiency * np.pi / 4.0, rel=1e-3)


def test_small_particles_scatter_as_rayleighs() -> None:
    diameter, m = 2e-6, 1.59 / 1.333
    table = mie_table(np.array([diameter]), 1.59 + 0j, 1.333, 532.0, (0.0, np.pi))
    k = 2.0 * np.pi * 1.333 / WAVELENGTH_MM
    polarisability = (m**2 - 1.0) / (m**2 + 2.0)
    expected = (
        k**4
        * (diameter / 2.0) ** 6
        * polarisability**2
        * (1.0 + np.cos(table.angles_rad) ** 2)
        / 2.0
    )
    np.testing.assert_allclose(
        table.cross_section(table.angles_rad, np.full(len(expected), diameter)), expected, rtol=2e-3
    )


def test_a_cloud_scatters_as_the_mean_of_its_sizes() -> None:
    sizes = np.array([0.004, 0.008])
    both = mie_table(
        sizes.repeat([120, 40]), 1.59 + 0j, 1.333, 532.0, (1.0, 2.0)
    ).per_square_diameter
    small, large = (
        mie_table(sizes[[i]], 1.59 + 0j, 1.333, 532.0, (1.0, 2.0)).per_square_diameter
        for i in (0, 1)
    )
    np.testing.assert_allclose(both, 0.75 * small + 0.25 * large, rtol=1e-9)


def test_averaging_keeps_straight_lines_and_smooths() -> None:
    table = mie_table(np.array([0.05]), 1.59 + 0j, 1.333, 532.0, (1.0, 2.0))
    angles = table.angles_rad
    line = MieTable(angles, 3.0 - 0.7 * angles).averaged(0.01)
    inner = slice(60, -60)
    np.testing.assert_allclose(
        line.per_square_diameter[inner], (3.0 - 0.7 * angles)[inner], rtol=1e-12
    )
    previous = table.per_square_diameter
    for half_angle in (0.002, 0.004, 0.01):
        averaged = table.averaged(half_angle).per_square_diameter
        assert np.abs(np.diff(averaged)).sum() < np.abs(np.diff(previous)).sum()
        previous = averaged
    np.testing.assert_array_equal(
        table.averaged(0.0).per_square_diameter, table.per_square_diameter
    )


def test_averaging_is_the_mean_over_a_round_aperture() -> None:
    table, half = mie_table(np.array([0.03]), 1.59 + 0j, 1.333, 532.0, (1.2, 1.9)), 0.012
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (400_000, 2))
    across = points[np.hypot(*points.T) < 1.0, 0] * half
    for angle in (1.3, 1.5, 1.75):
        expected = table.cross_section(angle + across, np.ones_like(across)).mean()
        found = table.averaged(half).cross_section(np.array([angle]), np.ones(1))[0]
        assert found == pytest.approx(expected, rel=0.01)


# The sheet


@pytest.mark.parametrize("profile", ["top-hat", "gaussian"])
def test_sheet_holds_the_energy_of_its_pulse(profile: str) -> None:
    light = Illumination(
        pulse_energy_mj=3.0,
        thickness_mm=2.0,
        height_mm=40.0,
        direction=(1.0, 0.0, 0.0),
        sheet_normal=(0.0, 3.0, 4.0),
        profile=profile,
    )
    across = np.linspace(-6.0, 6.0, 24_001)
    center = np.array([1.0, -2.0, 30.0])
    positions = center + across[:, None] * [0.0, 0.6, 0.8] + [7.0, 0.0, 0.0]
    photons = np.trapezoid(fluence(light, center, positions), across) * 40.0
    assert photons * PLANCK_J_S * LIGHT_M_S / 532e-9 * 1e3 == pytest.approx(3.0, rel=1e-3)


def test_gaussian_sheet_falls_to_e_minus_2_at_half_its_width() -> None:
    light = Illumination(pulse_energy_mj=3.0, thickness_mm=2.0, height_mm=40.0, profile="gaussian")
    values = fluence(
        light, np.zeros(3), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [9.0, 9.0, -1.0]])
    )
    np.testing.assert_allclose(values[1:] / values[0], math.exp(-2.0), rtol=1e-12)


def test_the_series_is_miepython_s() -> None:
    """It sums the series of all angles at once, and miepython that of one after another."""
    sizes, angles = np.array([0.004, 0.031, 0.08]), (1.2, 1.3)
    table = mie_table(sizes, 1.59 - 0.001j, 1.333, 532.0, angles)
    wavenumber = 2.0 * np.pi * 1.333 / 532e-6
    quantiles = np.quantile(sizes, (np.arange(16) + 0.5) / 16)
    expected = 0.0
    for size in quantiles:
        pair = miepython.S1_S2(
            (1.59 - 0.001j) / 1.333,
            wavenumber * size / 2.0,
            np.cos(table.angles_rad),
            norm="wiscombe",
        )
        expected += sum(np.abs(s) ** 2 for s in pair) / (2.0 * wavenumber**2 * size**2)
    np.testing.assert_allclose(table.per_square_diameter, expected / 16, rtol=1e-12)
