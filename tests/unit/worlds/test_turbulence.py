"""Turbulence: the lengths that samples of its velocities show are those that were asked for."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.api import Flow
from sabench.api.make import generator_of
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused


def turbulence(**parameters: Any) -> Any:
    return generator_of({"generator": "turbulence", **parameters})


def places(count: int, size_mm: float) -> F64:
    return np.random.default_rng(1).uniform(-size_mm, size_mm, (count, 3))


def integral_length_mm(field: Flow, length_mm: float) -> float:
    rng, lines, count, step = np.random.default_rng(2), 3000, 28, 0.25 * length_mm
    along = rng.standard_normal((lines, 1, 3))
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    start = rng.uniform(-1e3, 1e3, (lines, 1, 3)) * length_mm
    points = start + step * np.arange(count)[:, None] * along
    speed = (field.velocity(points.reshape(-1, 3), 0.0).reshape(points.shape) * along).sum(axis=2)
    f = np.array([np.mean(speed[:, r:] * speed[:, : count - r]) for r in range(21)])
    return float(step * np.trapezoid(f / f[0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "asked",
    [
        {"rms_mm_s": 50.0, "integral_mm": 20.0, "kolmogorov_mm": 1.0},
        {"rms_mm_s": 50.0, "integral_mm": 20.0, "viscosity_mm2_s": 1.0},
        {"rms_mm_s": 10.0, "integral_mm": 10.0, "viscosity_mm2_s": 15.0},
    ],
)
def test_measured_lengths_are_those_asked_for(asked: dict[str, float]) -> None:
    field, length = turbulence(**asked), asked["integral_mm"]
    assert integral_length_mm(field, length) == pytest.approx(length, rel=0.05)
    points, step = places(8000, 1e3 * length), 0.01 * field.kolmogorov_mm
    speed = field.velocity(points, 0.0)
    assert_allclose(speed.std(axis=0), asked["rms_mm_s"], rtol=0.03)
    slope = (field.velocity(points + step * np.eye(3)[0], 0.0) - speed)[:, 0] / step
    viscosity = field.viscosity_mm2_s
    kolmogorov = (viscosity**3 / (15.0 * viscosity * np.mean(slope**2))) ** 0.25
    assert kolmogorov == pytest.approx(asked.get("kolmogorov_mm", field.kolmogorov_mm), rel=0.02)
    assert viscosity == pytest.approx(asked.get("viscosity_mm2_s", viscosity), rel=1e-9)


def test_dissipation_is_that_of_large_eddies() -> None:
    """epsilon L / u'^3 of a high Reynolds number is .4 to 1 in experiments and simulations."""
    field = turbulence(rms_mm_s=100.0, integral_mm=50.0, viscosity_mm2_s=1.0)
    slope = field.gradient(places(4000, 5e4), 0.0)[:, 0, 0]
    assert 0.4 < 15.0 * 1.0 * np.mean(slope**2) * 50.0 / 100.0**3 < 1.0


def test_slopes_are_not_skewed() -> None:
    slope = turbulence().gradient(places(4000, 1e4), 0.0)[:, 0, 0]
    assert abs(np.mean(slope**3) / np.mean(slope**2) ** 1.5) < 0.15


def test_every_mode_forgets_at_its_turnover_rate() -> None:
    """The correlation over time is the sum of the energies' normal decays."""
    delay, measured = np.array([0.1, 0.2, 0.4]), []
    points = places(400, 1e4)
    for draw in range(30):
        field = turbulence(draw=draw, kolmogorov_mm=1.0)
        now = field.velocity(points, 0.3)
        later = [field.velocity(points, 0.3 + time) for time in delay]
        measured.append([np.sum(now * then) / np.sum(now**2) for then in later])
    shells = turbulence(kolmogorov_mm=1.0)._shells
    rate2 = shells.numbers**3 * shells.energies / shells.widths
    rate2 *= (50.0 * shells.integral / 20.0) ** 2
    decay = np.exp(-0.5 * 0.5**2 * rate2 * delay[:, None] ** 2)
    expected = decay @ shells.energies / shells.energies.sum()
    assert_allclose(np.mean(measured, axis=0), expected, atol=0.06)
    assert expected[-1] < 0.8


def test_without_unsteadiness_the_field_is_frozen() -> None:
    field, points = turbulence(unsteadiness=0.0), places(10, 20.0)
    assert_array_equal(field.velocity(points, 0.0), field.velocity(points, 7.0))


@pytest.mark.parametrize(
    ("parameters", "keys"),
    [
        ({"integral_mm": 20.0, "kolmogorov_mm": 15.0}, ["kolmogorov_mm", "0.00027 to 10"]),
        ({"integral_mm": 2.0, "viscosity_mm2_s": 1e3}, ["viscosity_mm2_s"]),
        ({"kolmogorov_mm": 1.0, "viscosity_mm2_s": 1.0}, ["kolmogorov_mm", "viscosity_mm2_s"]),
    ],
)
def test_impossible_lengths_are_one_sentence(parameters: Any, keys: list[str]) -> None:
    with refused(*keys) as caught:
        turbulence(**parameters)
    assert len(str(caught.value).splitlines()) == 1
