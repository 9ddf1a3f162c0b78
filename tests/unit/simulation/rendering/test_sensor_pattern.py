"""Pixels that differ, by the measures of EMVA standard 1288, release 4.0 linear.

They are taken from stacks of images alone: section 6.5 (photon transfer), 8.2 (spatial variances
less the temporal noise that is left in the mean of a stack), 6.7 (linearity error).
"""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from sabench.scenes.sensor import Sensor
from sabench.simulation.rendering.sensor import Pattern, expose, make_pattern
from sabench.utils.arrays import F64
from sabench.utils.rng import stream

_SHAPE, _STACK = (120, 200), 40
_BASE = {
    "quantum_efficiency": 0.5,
    "read_noise_e": 6.0,
    "full_well_e": 2e4,
    "gain_dn_e": 0.2,
    "black_level_dn": 60.0,
    "bit_depth": 12,
}


def sensor_with(**flaws: float) -> Sensor:
    return Sensor.model_validate(_BASE | flaws)


def take(sensor: Sensor, photons: float, pattern: Pattern, seed: int = 1) -> F64:
    """Take a stack of images of uniform light."""
    light, rng = np.full(_SHAPE, photons), np.random.default_rng(seed)
    return np.stack([expose(sensor, light, rng, pattern) for _ in range(_STACK)]).astype(float)


def spatial_variance(stack: F64) -> float:
    """Compute the variance between pixels, less the noise that the mean of the stack has left."""
    left = stack.var(axis=0, ddof=1).mean() / len(stack)
    return float(stack.mean(axis=0).var(ddof=1) - left)


def test_photon_transfer_gives_the_gain_of_pixels_that_differ() -> None:
    sensor = sensor_with(prnu=0.02, dsnu_e=15.0)
    pattern = make_pattern(sensor, _SHAPE, np.random.default_rng(0))
    stacks = [take(sensor, photons, pattern) for photons in (0.0, 4000.0, 8000.0, 16000.0)]
    means = [stack.mean() for stack in stacks]
    variances = [stack.var(axis=0, ddof=1).mean() for stack in stacks]  # temporal: no pattern
    gain, offset = np.polyfit(means, variances, 1)
    assert gain == pytest.approx(0.2, rel=0.01)
    assert offset + gain * 60.0 == pytest.approx(0.2**2 * 6.0**2 + 1.0 / 12.0, rel=0.2)


def test_spatial_variances_give_prnu_and_dsnu() -> None:
    sensor = sensor_with(prnu=0.012, dsnu_e=8.0)
    pattern = make_pattern(sensor, _SHAPE, np.random.default_rng(3))
    dark, half = take(sensor, 0.0, pattern), take(sensor, 2e4, pattern)
    dsnu = np.sqrt(spatial_variance(dark)) / 0.2
    prnu = np.sqrt(spatial_variance(half) - spatial_variance(dark)) / (half.mean() - dark.mean())
    assert dsnu == pytest.approx(8.0, rel=0.02)
    assert prnu == pytest.approx(0.012, rel=0.02)


def test_a_sensor_without_flaws_has_no_spatial_variance() -> None:
    sensor = sensor_with()
    pattern = make_pattern(sensor, _SHAPE, np.random.default_rng(3))
    stack = take(sensor, 2e4, pattern)
    assert abs(spatial_variance(stack)) < 0.05 * stack.var(axis=0).mean() / _STACK
    light = np.full(_SHAPE, 500.0)
    alike = [expose(sensor, light, np.random.default_rng(5), one) for one in (None, pattern)]
    np.testing.assert_array_equal(alike[0], alike[1])


def test_linearity_error_follows_from_the_signal_at_the_full_well() -> None:
    sensor = sensor_with(nonlinearity=0.1).model_copy(
        update={"shot_noise": False, "read_noise_e": 0.0}
    )
    photons = np.linspace(0.0, 4e4, 9)  # the last fills the well
    grey = expose(sensor, photons[None], np.random.default_rng(0))[0].astype(float)
    signal = grey - 60.0
    assert sensor.white_dn == grey[-1] == round(60.0 + 0.2 * 0.9 * 2e4)
    error = signal / (0.2 * 0.5 * np.maximum(photons, 1e-9)) - 1.0
    np.testing.assert_allclose(error[1:], -0.1 * (photons[1:] / 4e4) ** 2, atol=2e-3)


def test_hot_and_dead_pixels_have_their_shares_and_signals() -> None:
    sensor = sensor_with(hot_pixels=0.01, hot_e=3000.0, dead_pixels=0.02, dsnu_e=2.0)
    pattern = make_pattern(sensor, (400, 500), np.random.default_rng(2))
    hot, dead = pattern.hot_e > 0.0, pattern.response == 0.0
    assert hot.mean() == pytest.approx(0.01, rel=0.1)
    assert dead.mean() == pytest.approx(0.02, rel=0.1)
    assert pattern.hot_e[hot].mean() == pytest.approx(3000.0, rel=0.1)
    light = np.full((400, 500), 1000.0)
    grey = expose(sensor, light, np.random.default_rng(4), pattern).astype(float)
    noise = 0.2 * 6.0
    assert abs(grey[dead].mean() - 60.0) < 5.0 * noise / np.sqrt(dead.sum())
    expected = 0.2 * (500.0 + np.minimum(pattern.hot_e[hot], 19500.0).mean())
    assert grey[hot].mean() - 60.0 == pytest.approx(expected, rel=0.02)


def test_cameras_have_patterns_of_their_own() -> None:
    sensor = sensor_with(prnu=0.02, hot_pixels=0.01)
    first, second, again = (
        make_pattern(sensor, _SHAPE, stream(7, "sensor pattern", camera)) for camera in (0, 1, 0)
    )
    np.testing.assert_array_equal(first.response, again.response)
    assert abs(np.corrcoef(first.response.ravel(), second.response.ravel())[0, 1]) < 0.03
    assert (first.hot_e.astype(bool) & second.hot_e.astype(bool)).mean() < 1e-3


@pytest.mark.parametrize(
    ("flaws", "said"),
    [
        ({"dsnu_e": 1e4}, "dsnu_e: expected at most a third of full_well_e = 20000 electrons"),
        ({"hot_pixels": 0.2}, "less than or equal to 0.05"),
        ({"hot_pixels": 0.01, "hot_e": 3e4}, "hot_e: expected at most full_well_e = 20000"),
        ({"hot_e": 100.0}, "hot_e: expected hot_pixels, their share, next to it, got none"),
        ({"camera_black_dn": [60.0, 5000.0]}, "expected less than the white level 4095, got 5000"),
    ],
)
def test_flaws_beyond_the_range_are_refused(flaws: dict[str, float], said: str) -> None:
    with pytest.raises(ValidationError) as error:
        sensor_with(**flaws)
    assert said in str(error.value)
