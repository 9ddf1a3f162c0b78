"""Noise of the sensor: exact distributions, and pixels that do not depend on each other.

A sensor with 16 bits and one grey value for each electron shows the numbers that were drawn; an
offset of its pixels brings large ones into its range.
"""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy import stats

from sabench.scenes.sensor import Sensor
from sabench.simulation.rendering.sensor import Pattern, expose
from sabench.utils.arrays import F64, I64, U16
from sabench.utils.errors import InputError
from sabench.utils.rng import stream

_COUNTER = Sensor(quantum_efficiency=1.0, full_well_e=1e12, gain_dn_e=1.0, bit_depth=16)
_SHAPE, _MIDDLE, _UNLIKELY = (500, 1000), 30000, 1e-4


def electrons(mean: float, seed: int, shape: tuple[int, int] = _SHAPE) -> I64:
    """Draw electrons of pixels with the same mean."""
    shift = max(0, round(mean) - _MIDDLE)
    one, none = np.ones(shape), np.zeros(shape)
    pattern = Pattern(one, none, none - shift)
    grey = expose(_COUNTER, np.full(shape, mean), np.random.default_rng(seed), pattern)
    return grey.astype(np.int64).ravel() + shift


def deviates(seed: int, shape: tuple[int, int] = _SHAPE) -> F64:
    """Draw read noise, in its standard deviations; it is rounded to 1/4000."""
    sensor = _COUNTER.model_copy(
        update={"shot_noise": False, "read_noise_e": 4000.0, "black_level_dn": 32000.0}
    )
    grey = expose(sensor, np.zeros(shape), np.random.default_rng(seed))
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
    "mean",
    [
        1e-3,
        0.1,
        0.1249,
        0.125,
        0.3,
        0.7,
        1.0,
        3.3,
        9.999,
        10.0,
        10.5,
        15.9,
        40.0,
        300.0,
        1e4,
        1e5,
        1e6,
    ],
)
def test_electrons_have_poissons_distribution(mean: float) -> None:
    """Below 0.125, from there to 10 and above, other algorithms draw; all are compared as one.

    Bins are as wide as a thirtieth of the standard deviation, single numbers where they can be.
    """
    drawn = electrons(mean, seed=1)
    law = stats.poisson(mean)
    edges = (
        np.unique(
            np.ceil(
                np.arange(
                    mean - 6 * mean**0.5 - 1, mean + 6 * mean**0.5 + 8, max(1.0, mean**0.5 / 30.0)
                )
            )
        )
        - 0.5
    )
    observed = np.histogram(drawn, np.concatenate([[-np.inf], edges, [np.inf]]))[0]
    below = np.concatenate([[0.0], law.cdf(edges), [1.0]])
    assert chi_square(observed.astype(float), np.diff(below) * drawn.size) > _UNLIKELY
    assert abs(drawn.mean() - mean) < 4.0 * np.sqrt(mean / drawn.size)
    variance_error = np.sqrt((2.0 * mean**2 + mean) / drawn.size)
    assert abs(drawn.var() - mean) < 4.0 * variance_error


@pytest.mark.parametrize("mean", [0.05, 4.0, 12.0, 100.0, 1e4, 1e6])
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


def test_no_light_gives_no_electrons_and_much_light_its_mean() -> None:
    assert not electrons(0.0, seed=3).any()
    dim = electrons(1e-9, seed=3, shape=(100, 100))
    assert not dim.any()


def test_very_many_electrons_are_normal() -> None:
    mean, shape = 1e13, (300, 300)
    sensor = _COUNTER.model_copy(update={"full_well_e": 2e13, "gain_dn_e": 4000.0 / mean**0.5})
    one, none = np.ones(shape), np.zeros(shape)
    pattern = Pattern(one, none, none - mean + 8.0 * mean**0.5)
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


def test_frames_and_cameras_do_not_depend_on_each_other() -> None:
    sensor = _COUNTER.model_copy(update={"read_noise_e": 20.0, "black_level_dn": 500.0})
    light = np.full((300, 400), 400.0)
    shots = [
        expose(sensor, light, stream(seed, "sensor", frame, camera)).astype(np.float64) - 900.0
        for seed, frame, camera in ((1, 0, 0), (1, 0, 1), (1, 1, 0), (2, 0, 0))
    ]
    for number, one in enumerate(shots):
        for other in shots[number + 1 :]:
            assert_unrelated(one, other)


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
    with pytest.raises(InputError, match="photon counts must be finite and not negative"):
        noisy(light)
