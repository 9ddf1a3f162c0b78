"""Terminal velocity of bubbles, against other laws and measurements."""

import numpy as np
import pytest
from scipy.optimize import brentq

from reproduction.rise_velocity import (
    Liquid,
    moore,
    spheroid_velocity,
    terminal_velocity,
    transition_diameter_mm,
    wave_velocity,
)
from tests.helpers.refusals import refused

WATER = Liquid()


def ball_velocity(diameter_mm: float) -> float:
    """Balance a clean ball's drag after Mei, Klausner and Lawrence (1994)."""
    d = 1e-3 * diameter_mm

    def excess(speed: float) -> float:
        re = speed * d / WATER.viscosity
        drag = 16.0 / re * (1.0 + 1.0 / (8.0 / re + 0.5 * (1.0 + 3.315 / np.sqrt(re))))
        return float(drag * speed**2 - 4.0 / 3.0 * WATER.gravity * d)

    return float(brentq(excess, 1e-4, 2.0))


def test_small_bubbles_are_balls() -> None:
    for diameter in (0.45, 0.6):
        own = float(spheroid_velocity(np.array(diameter), WATER)[0])
        assert own == pytest.approx(ball_velocity(diameter), rel=0.06)


def test_moore_s_factors_of_nearly_round_bubbles() -> None:
    chi = np.array([1.0005, 1.001])
    weber, g, h = moore(chi)
    assert weber == pytest.approx(64.0 / 9.0 * (chi - 1.0), rel=5e-3)  # his expansion
    assert g == pytest.approx(1.0, abs=0.02)
    assert h == pytest.approx(-2.211, abs=0.02)


def test_the_fastest_and_the_slowest_bubble_in_clean_water() -> None:
    """Duineveld (1995) measured some 0.35 m/s at 1.8 mm; the minimum is at sqrt of 2.14 / 0.505."""
    d = np.linspace(0.3, 9.0, 400)
    u = terminal_velocity(d, WATER)
    assert np.isfinite(u).all()
    top = int(u.argmax())
    assert 1.4 < d[top] < 2.0
    assert 0.31 < u[top] < 0.37
    least = top + int(u[top:].argmin())
    assert d[least] == pytest.approx(WATER.slowest_mm, abs=0.03)
    assert u[least] == pytest.approx(0.236, abs=0.001)


def test_the_law_depends_on_the_morton_number_alone() -> None:
    """Two liquids of one Mo: bubbles of one Eotvos number have one Froude number."""
    other = Liquid(density=900.0, viscosity=2e-6, gravity=9.81)
    tension = (other.gravity * other.viscosity**4 * other.density**3 / WATER.morton) ** (1 / 3)
    other = Liquid(900.0, 2e-6, tension)
    assert other.morton == pytest.approx(WATER.morton)
    scale = np.sqrt(other.tension / other.density / (WATER.tension / WATER.density))
    d = np.array([0.5, 1.0, 2.0, 6.0])
    own, its = terminal_velocity(d, WATER), terminal_velocity(scale * d, other)
    assert own**2 / d == pytest.approx(its**2 / (scale * d), rel=1e-6)


@pytest.mark.slow
def test_bubbles_below_the_penetration_depth_rise_as_fast_as_the_slowest_large_one() -> None:
    for largest, slowest in ((4.88, 4.88), (8.64, WATER.slowest_mm)):
        d = transition_diameter_mm(largest, WATER)
        rising = float(terminal_velocity(np.array(d), WATER)[0])
        assert rising == pytest.approx(float(wave_velocity(np.array(slowest), WATER)), rel=2e-3)
        assert 0.9 < d < 1.05
    with refused("largest_mm", kind=ValueError):
        transition_diameter_mm(0.1, WATER)
