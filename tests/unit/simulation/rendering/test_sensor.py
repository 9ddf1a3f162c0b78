"""Sensors: noise, fixed pattern, and grey values of photons."""

import math

import numba
import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from sabench.scenes.sensor import Sensor
from sabench.simulation.rendering.sensor import (
    FixedPattern,
    expose,
    make_pattern,
)
from sabench.utils.arrays import F64, I64, U16
from sabench.utils.rng import stream
from tests.helpers.refusals import refused

_COUNTER = Sensor(quantum_efficiency=1.0, full_well_e=1e12, gain_dn_e=1.0, bit_depth=16)
_SHAPE, _MIDDLE, _UNLIKELY = (500, 1000), 30000, 1e-4


def electrons(mean: float, seed: int, shape: tuple[int, int] = _SHAPE) -> I64:
    shift = max(0, round(mean) - _MIDDLE)
    one, none = np.ones(shape), np.zeros(shape)
    pattern = FixedPattern(one, none, none - shift)
    grey = expose(_COUNTER, np.full(shape, mean), np.random.default_rng(seed), pattern)
    return grey.astype(np.int64).ravel() + shift


def deviates(seed: int, shape: tuple[int, int] = _SHAPE) -> F64:
    """Draw read noise, in its standard deviations; it is rounded to 1/4000."""
    noise = {"shot_noise": False, "read_noise_e": 4000.0, "black_level_dn": 32000.0}
    grey = expose(_COUNTER.model_copy(update=noise), np.zeros(shape), np.random.default_rng(seed))
    return np.asarray((grey - 32000.0) / 4000.0)


def chi_square(observed: F64, expected: F64) -> float:
    """Compute the chance of more scatter, where enough are expected."""
    many = expected > 10.0
    pooled = [np.append(each[many], each[~many].sum()) for each in (observed, expected)]
    kept = pooled[1] > 0.0
    scatter = ((pooled[0] - pooled[1])[kept] ** 2 / pooled[1][kept]).sum()
    return float(stats.chi2.sf(scatter, kept.sum() - 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "mean", [1e-3, 0.1249, 0.125, 0.7, 3.3, 9.999, 10.0, 15.9, 300.0, 1e4, 1e6]
)
def test_electrons_have_poissons_distribution(mean: float) -> None:
    """Three algorithms draw, with limits at 0.125 and 10; bins are 1/30 of a deviation wide."""
    drawn = electrons(mean, seed=1)
    law = stats.poisson(mean)
    reach, step = 6 * mean**0.5, max(1.0, mean**0.5 / 30.0)
    edges = np.unique(np.ceil(np.arange(mean - reach - 1, mean + reach + 8, step))) - 0.5
    observed = np.histogram(drawn, np.concatenate([[-np.inf], edges, [np.inf]]))[0]
    below = np.concatenate([[0.0], law.cdf(edges), [1.0]])
    assert chi_square(observed.astype(float), np.diff(below) * drawn.size) > _UNLIKELY
    assert abs(drawn.mean() - mean) < 4.0 * np.sqrt(mean / drawn.size)
    variance_error = np.sqrt((2.0 * mean**2 + mean) / drawn.size)
    assert abs(drawn.var() - mean) < 4.0 * variance_error


@pytest.mark.slow_but_first
@pytest.mark.parametrize("mean", [0.05, 4.0, 12.0, 1e6])
def test_tails_of_electrons_are_poissons(mean: float) -> None:
    """Numbers beyond 4 standard deviations, of two million."""
    drawn = electrons(mean, seed=2, shape=(2000, 1000))
    low, high = np.floor(mean - 4.0 * mean**0.5), np.ceil(mean + 4.0 * mean**0.5)
    law = stats.poisson(mean)
    for count, chance in (
        ((drawn < low).sum(), law.cdf(low - 1.0)),
        ((drawn > high).sum(), law.sf(high)),
    ):
        assert stats.binomtest(int(count), drawn.size, float(chance)).pvalue > _UNLIKELY


def test_no_light_gives_no_electrons() -> None:
    for mean in (0.0, 1e-9):
        assert not electrons(mean, seed=3, shape=(100, 100)).any()


def test_very_many_electrons_are_normal() -> None:
    mean, shape = 1e13, (300, 300)
    sensor = _COUNTER.model_copy(update={"full_well_e": 2e13, "gain_dn_e": 4000.0 / mean**0.5})
    one, none = np.ones(shape), np.zeros(shape)
    pattern = FixedPattern(one, none, none - mean + 8.0 * mean**0.5)
    grey = expose(sensor, np.full(shape, mean), np.random.default_rng(3), pattern)
    assert stats.kstest(grey.ravel() / 4000.0 - 8.0, "norm").pvalue > _UNLIKELY


def test_read_noise_is_normal_to_its_tails() -> None:
    drawn = deviates(seed=4, shape=(4000, 1000)).ravel()
    assert stats.kstest(drawn[::40], "norm").pvalue > _UNLIKELY
    edges = np.linspace(-5.2, 5.2, 417) + 0.5 / 4000.0
    observed = np.histogram(drawn, np.concatenate([[-np.inf], edges, [np.inf]]))[0]
    below = np.concatenate([[0.0], stats.norm.cdf(edges), [1.0]])
    assert chi_square(observed.astype(float), np.diff(below) * drawn.size) > _UNLIKELY
    for start in (3.6, 3.65, 3.7, 4.0, 4.5):  # the ziggurat's tail begins at 3.654
        chance = 2.0 * stats.norm.sf(start + 0.5 / 4000.0)
        count = int((np.abs(drawn) > start + 0.5 / 4000.0).sum())
        assert stats.binomtest(count, drawn.size, chance).pvalue > _UNLIKELY


def test_shot_noise_and_read_noise_do_not_depend_on_each_other() -> None:
    light = np.full(_SHAPE, 900.0)
    shot = np.asarray(electrons(900.0, seed=5).reshape(_SHAPE) - 900.0)
    both = _COUNTER.model_copy(update={"read_noise_e": 60.0, "black_level_dn": 1000.0})
    read = np.asarray(expose(both, light, np.random.default_rng(5)) - 1900.0 - shot)
    assert read.std() == pytest.approx(60.0, rel=0.01)
    assert_unrelated(shot, read)


def assert_unrelated(one: F64, other: F64) -> None:
    """Compare correlations of values, squares and both with their standard error."""
    first, second = one.ravel() / one.std(), other.ravel() / other.std()
    for a in (first, first**2):
        for b in (second, second**2):
            assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(a.size)


@pytest.mark.parametrize(
    "draw", [lambda seed: deviates(seed), lambda seed: electrons(4.0, seed).reshape(_SHAPE) - 4.0]
)
def test_neighbours_do_not_depend_on_each_other(draw: object) -> None:
    image = draw(6)  # type: ignore[operator]
    for down, across in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (0, 8), (0, 16), (7, 3)):
        rows, columns = image.shape
        assert_unrelated(image[: rows - down, : columns - across], image[down:, across:])
    assert_unrelated(image[:, :500], image[:, 500:])


def noisy(light: F64) -> U16:
    sensor = _COUNTER.model_copy(update={"read_noise_e": 5.0, "black_level_dn": 100.0})
    return expose(sensor, light, np.random.default_rng(7))


def test_any_number_of_threads_gives_the_same_noise() -> None:
    light, most = np.random.default_rng(8).exponential(50.0, (211, 307)), numba.get_num_threads()
    shots = []
    try:
        for threads in range(1, most + 1):
            numba.set_num_threads(threads)
            shots.append(noisy(light))
    finally:
        numba.set_num_threads(most)
    for shot in shots[1:]:
        np.testing.assert_array_equal(shot, shots[0])


def test_noise_of_a_pixel_depends_on_its_own_light_and_place_alone() -> None:
    light = np.random.default_rng(9).exponential(50.0, (60, 90))
    whole = noisy(light)
    np.testing.assert_array_equal(noisy(light[:40, :70]), whole[:40, :70])
    light[20, 30] *= 7.0
    assert np.argwhere(noisy(light) != whole).tolist() == [[20, 30]]


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, -1.0])
def test_light_that_is_no_number_of_photons_is_refused(wrong: float) -> None:
    light = np.full((30, 40), 10.0)
    light[20, 10] = wrong
    with refused():
        noisy(light)


def test_photon_transfer() -> None:
    """EMVA 1288: mean = black + K mu_e, variance = K^2 (mu_e + read^2) + 1/12 of the rounding."""
    levels = {"full_well_e": 5e4, "gain_dn_e": 0.8, "black_level_dn": 100.0, "bit_depth": 16}
    noise = {"dark_current_e_s": 2000.0, "exposure_s": 5e-3, "read_noise_e": 4.0}
    sensor = Sensor.model_validate(levels | noise | {"quantum_efficiency": 0.5})
    rng = np.random.default_rng(6)
    for photons in (0.0, 300.0, 4000.0):
        grey = expose(sensor, np.full((300, 500), photons), rng).astype(np.float64)
        electrons = 0.5 * photons + 10.0
        variance = 0.8**2 * (electrons + 16.0) + 1.0 / 12.0
        error = 5.0 * math.sqrt(variance / grey.size)
        assert grey.mean() == pytest.approx(100.0 + 0.8 * electrons, abs=error)
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
    assert sensor.full_well_photons == 4000.0
    half = expose(sensor, np.full((300, 500), 2000.0), np.random.default_rng(0))
    assert half.mean() - sensor.black_level_dn == pytest.approx(500.0, rel=1e-3)


def test_without_noise_the_grey_value_is_rounded() -> None:
    levels = {"full_well_e": 400.0, "gain_dn_e": 0.25, "black_level_dn": 10.0, "bit_depth": 10}
    sensor = Sensor.model_validate(levels | {"shot_noise": False, "quantum_efficiency": 0.5})
    photons = np.array([[0.0, 7.0, 9.0], [20.0, 100.0, 1e6]])
    for seed in (0, 1):
        grey = expose(sensor, photons, np.random.default_rng(seed))
        np.testing.assert_array_equal(grey, [[10, 11, 11], [12, 22, 110]])


def test_read_noise_never_goes_below_zero() -> None:
    sensor = Sensor(read_noise_e=50.0, black_level_dn=0.0)
    grey = expose(sensor, np.zeros((40, 60)), np.random.default_rng(3))
    assert grey.min() == 0
    assert 0.4 < (grey == 0).mean() < 0.6


_SMALL, _STACK = (120, 200), 40
_BASE = {"quantum_efficiency": 0.5, "read_noise_e": 6.0, "full_well_e": 2e4, "gain_dn_e": 0.2}
_BASE |= {"black_level_dn": 60.0, "bit_depth": 12}


def sensor_with(**flaws: float) -> Sensor:
    return Sensor.model_validate(_BASE | flaws)


def take(sensor: Sensor, photons: float, pattern: FixedPattern, seed: int = 1) -> F64:
    light, rng = np.full(_SMALL, photons), np.random.default_rng(seed)
    return np.stack([expose(sensor, light, rng, pattern) for _ in range(_STACK)]).astype(float)


def spatial_variance(stack: F64) -> float:
    """Compute the variance between pixels, less the noise that the mean of the stack has left."""
    left = stack.var(axis=0, ddof=1).mean() / len(stack)
    return float(stack.mean(axis=0).var(ddof=1) - left)


def test_photon_transfer_gives_the_gain_of_pixels_that_differ() -> None:
    sensor = sensor_with(prnu=0.02, dsnu_e=15.0)
    pattern = make_pattern(sensor, _SMALL, np.random.default_rng(0))
    stacks = [take(sensor, photons, pattern) for photons in (0.0, 4000.0, 8000.0, 16000.0)]
    means = [stack.mean() for stack in stacks]
    variances = [stack.var(axis=0, ddof=1).mean() for stack in stacks]  # temporal: no pattern
    gain, offset = np.polyfit(means, variances, 1)
    assert gain == pytest.approx(0.2, rel=0.01)
    assert offset + gain * 60.0 == pytest.approx(0.2**2 * 6.0**2 + 1.0 / 12.0, rel=0.2)


def test_spatial_variances_give_prnu_and_dsnu() -> None:
    sensor = sensor_with(prnu=0.012, dsnu_e=8.0)
    pattern = make_pattern(sensor, _SMALL, np.random.default_rng(3))
    dark, half = take(sensor, 0.0, pattern), take(sensor, 2e4, pattern)
    dsnu = np.sqrt(spatial_variance(dark)) / 0.2
    prnu = np.sqrt(spatial_variance(half) - spatial_variance(dark)) / (half.mean() - dark.mean())
    assert dsnu == pytest.approx(8.0, rel=0.02)
    assert prnu == pytest.approx(0.012, rel=0.02)


def test_a_sensor_without_flaws_has_no_spatial_variance() -> None:
    sensor = sensor_with()
    pattern = make_pattern(sensor, _SMALL, np.random.default_rng(3))
    stack = take(sensor, 2e4, pattern)
    assert abs(spatial_variance(stack)) < 0.05 * stack.var(axis=0).mean() / _STACK
    light = np.full(_SMALL, 500.0)
    alike = [expose(sensor, light, np.random.default_rng(5), one) for one in (None, pattern)]
    np.testing.assert_array_equal(alike[0], alike[1])


def test_linearity_error_follows_from_the_signal_at_the_full_well() -> None:
    sensor = sensor_with(nonlinearity=0.1, shot_noise=False, read_noise_e=0.0)
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
        make_pattern(sensor, _SMALL, stream(7, "sensor pattern", camera)) for camera in (0, 1, 0)
    )
    np.testing.assert_array_equal(first.response, again.response)
    assert abs(np.corrcoef(first.response.ravel(), second.response.ravel())[0, 1]) < 0.03
    assert (first.hot_e.astype(bool) & second.hot_e.astype(bool)).mean() < 1e-3


@pytest.mark.parametrize(
    ("key", "flaws"),
    [
        ("dsnu_e", {"dsnu_e": 1e4}),
        ("hot_pixels", {"hot_pixels": 0.2}),
        ("hot_e", {"hot_pixels": 0.01, "hot_e": 3e4}),
        ("hot_e", {"hot_e": 100.0}),
        ("camera_black_dn", {"camera_black_dn": [60.0, 5000.0]}),
    ],
)
def test_flaws_beyond_the_range_are_refused(key: str, flaws: dict[str, float]) -> None:
    with refused(key, kind=ValidationError):
        sensor_with(**flaws)
