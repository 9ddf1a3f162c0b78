"""Table 5.1: the printed values, and what they are."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction.chapter_5 import JETS, fall, froude, reynolds, table_5_1, weber
from sabench.worlds.library.rise_velocity import Liquid

WATER = Liquid()


def test_numbers_of_a_jet_are_ratios_of_forces() -> None:
    """Inertia over viscous force, weight and tension, and We / Re as the capillary number."""
    flow = 3.0, 6.0, WATER
    assert reynolds(*flow) == pytest.approx(18000.0)
    assert froude(*flow) == pytest.approx(9.0 / (9.81 * 0.006))
    mu = WATER.viscosity * WATER.density
    assert weber(*flow) / reynolds(*flow) == pytest.approx(mu * 3.0 / WATER.tension)
    assert WATER.morton == pytest.approx(weber(*flow) ** 3 / (froude(*flow) * reynolds(*flow) ** 4))


def test_a_falling_jet_keeps_its_flow_and_energy() -> None:
    speed, diameter = fall(2.0, 6.0, 100.0, WATER)
    assert speed * diameter**2 == pytest.approx(2.0 * 36.0)
    assert speed**2 - 4.0 == pytest.approx(2.0 * 9.81 * 0.1)


@pytest.mark.parametrize("height", JETS)
def test_the_printed_values_follow_from_a_froude_number_without_its_square(height: int) -> None:
    jet = JETS[height]
    assert 2e3 * jet.speed_m_s / (9.81 * jet.diameter_mm) == pytest.approx(jet.froude, abs=0.6)
    assert weber(jet.speed_m_s, jet.diameter_mm, WATER) / 2.0 == pytest.approx(jet.weber, rel=4e-3)
    start = np.mean([one.speed_m_s * one.diameter_mm**2 for one in JETS.values()]) / 6.35**2
    speed, diameter = fall(float(start), 6.35, height * float(start), WATER)
    assert (speed, diameter) == pytest.approx((jet.speed_m_s, jet.diameter_mm), abs=0.006)


def test_rows_say_which_column_is_which() -> None:
    found = list(table_5_1([1], None))
    assert found[0].verdict == found[1].verdict == "reproduced"  # type: ignore[union-attr]
