"""The sensor's laws: photon transfer, limits, rounding, seeds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sabench.scenes.sensor import Sensor
from sabench.simulation.rendering.sensor import expose, full_well_photons


def test_photon_transfer() -> None:
    """EMVA 1288: mean and variance of the sensor.

    mean = black + K mu_e and variance = K^2 (mu_e + read^2) + 1/12 of the rounding.
    """
    sensor = Sensor(
        quantum_efficiency=0.5,
        dark_current_e_s=2000.0,
        exposure_s=5e-3,
        read_noise_e=4.0,
        full_well_e=5e4,
        gain_dn_e=0.8,
        black_level_dn=100.0,
        bit_depth=16,
    )
    rng = np.random.default_rng(6)
    for photons in (0.0, 300.0, 4000.0):
        grey = expose(sensor, np.full((300, 500), photons), rng).astype(np.float64)
        electrons = 0.5 * photons + 10.0
        variance = 0.8**2 * (electrons + 16.0) + 1.0 / 12.0
        assert grey.mean() == pytest.approx(
            100.0 + 0.8 * electrons, abs=5.0 * math.sqrt(variance / grey.size)
        )
        assert grey.var() == pytest.approx(variance, rel=5.0 * math.sqrt(2.0 / grey.size))


def test_a_full_well_and_the_converter_limit_the_grey_value() -> None:
    photons = np.full((3, 5), 1e7)
    well = Sensor(full_well_e=1000.0, gain_dn_e=0.5, black_level_dn=20.0, bit_depth=12)
    converter = Sensor(full_well_e=1e6, gain_dn_e=0.5, black_level_dn=20.0, bit_depth=8)
    for sensor, top in ((well, 520), (converter, 255)):
        assert sensor.white_dn == top
        assert (expose(sensor, photons, np.random.default_rng(0)) == top).all()


def test_that_many_photons_fill_the_well() -> None:
    """A quarter of the photons become electrons, so that it takes four for each."""
    sensor = Sensor(full_well_e=1000.0, quantum_efficiency=0.25, bit_depth=16, gain_dn_e=1.0)
    assert full_well_photons(sensor) == 4000.0
    half = expose(
        sensor, np.full((300, 500), 0.5 * full_well_photons(sensor)), np.random.default_rng(0)
    )
    assert half.mean() - sensor.black_level_dn == pytest.approx(500.0, rel=1e-3)


def test_without_noise_the_grey_value_is_rounded() -> None:
    sensor = Sensor(
        shot_noise=False,
        quantum_efficiency=0.5,
        gain_dn_e=0.25,
        black_level_dn=10.0,
        full_well_e=400.0,
        bit_depth=10,
    )
    photons = np.array([[0.0, 7.0, 9.0], [20.0, 100.0, 1e6]])
    np.testing.assert_array_equal(
        expose(sensor, photons, np.random.default_rng(0)), [[10, 11, 11], [12, 22, 110]]
    )
    np.testing.assert_array_equal(
        expose(sensor, photons, np.random.default_rng(1)),
        expose(sensor, photons, np.random.default_rng(2)),
    )


def test_noise_is_that_of_its_generator() -> None:
    sensor, photons = Sensor(read_noise_e=3.0), np.full((20, 30), 500.0)
    first, again, other = (
        expose(sensor, photons, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert first.dtype == np.uint16


def test_read_noise_never_goes_below_zero() -> None:
    grey = expose(
        Sensor(read_noise_e=50.0, black_level_dn=0.0), np.zeros((40, 60)), np.random.default_rng(3)
    )
    assert grey.min() == 0
    assert 0.4 < (grey == 0).mean() < 0.6
