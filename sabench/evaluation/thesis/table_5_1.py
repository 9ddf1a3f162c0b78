"""Table 5.1: speed and diameter of the jets, and equations 5.1 to 5.4.

The table's columns of V_i and D_i are exchanged: V_i D_i^2 is constant, as the flow through one
nozzle is, and depths over D_i in figure 5-21 are whole bins only if the column of V_i holds D_i in
mm. The rows use them in this order. The printed Weber numbers have the radius for the diameter, the
printed Froude numbers are V / (g R), without the square. With that Froude number in Bernoulli's
equation, V_i^2 = V_0^2 (1 + 2 h / (Fr R)), the printed speeds and diameters follow to all digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sabench.evaluation.thesis.chapter_5 import JETS, MORTON, NOZZLE_MM, Jet
from sabench.evaluation.thesis.common import Item, claim, make_row
from sabench.metrics.plunging_jet import DEPTH_MM
from sabench.worlds.library.rise_velocity import Liquid

SEEDS = 1
_WATER = Liquid()
_DROP, _ABOVE = 21.6, 18.3  # Y / D_i of two neighbouring bins of figure 5-21, h = 43 mm


def reynolds(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Reynolds number, equation 5.1."""
    return speed_m_s * 1e-3 * diameter_mm / liquid.viscosity


def froude(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Froude number, equation 5.2."""
    return speed_m_s**2 / (liquid.gravity * 1e-3 * diameter_mm)


def weber(speed_m_s: float, diameter_mm: float, liquid: Liquid) -> float:
    """Compute the Weber number, equation 5.3."""
    return liquid.density * speed_m_s**2 * 1e-3 * diameter_mm / liquid.tension


def fall(
    speed_m_s: float, diameter_mm: float, height_mm: float, liquid: Liquid
) -> tuple[float, float]:
    """Compute speed and diameter of a jet after a fall, by Bernoulli and continuity."""
    speed = float(np.sqrt(speed_m_s**2 + 2.0 * liquid.gravity * 1e-3 * height_mm))
    return speed, diameter_mm * float(np.sqrt(speed_m_s / speed))


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Item]:
    """Compute the table from printed speeds and diameters; nothing is simulated."""
    yield from _order()
    for height, jet in JETS.items():
        yield from _numbers(height, jet)
    yield make_row("Morton number", MORTON, [_WATER.morton], "nu = 1e-6 m2/s, 73 mN/m")
    yield from _falls()


def _order() -> Iterator[Item]:
    """Decide which column is the speed."""
    flows = np.array([jet.speed_m_s * jet.diameter_mm**2 for jet in JETS.values()])
    printed = np.array([jet.diameter_mm * jet.speed_m_s**2 for jet in JETS.values()])
    spread, other = (float(100.0 * np.ptp(one) / one.mean()) for one in (flows, printed))
    yield claim(
        "V_i D_i^2, columns exchanged: spread, %",
        "one nozzle, one flow rate",
        spread,
        spread < 0.5,
        f"as printed {other:.1f} %: V_i and D_i stand in each other's column",
    )
    bin_mm = (_DROP - _ABOVE) * JETS[43].diameter_mm
    yield make_row(
        "bin of figure 5-21 in mm, D_i = 6.01 mm",
        DEPTH_MM,
        [bin_mm],
        f"D_i as printed: {(_DROP - _ABOVE) * JETS[43].speed_m_s:.1f} mm",
    )


def _numbers(height: int, jet: Jet) -> Iterator[Item]:
    flow = jet.speed_m_s, jet.diameter_mm, _WATER
    name = f"h = {height} mm: "
    yield make_row(f"{name}Reynolds number (5.1)", jet.reynolds, [reynolds(*flow)])
    half = weber(jet.speed_m_s, jet.diameter_mm / 2.0, _WATER)
    yield make_row(
        f"{name}Weber number (5.3)",
        jet.weber,
        [weber(*flow)],
        f"with the radius instead of the diameter {half:.0f}",
    )
    yield make_row(
        f"{name}Froude number (5.2)",
        jet.froude,
        [froude(*flow)],
        "V / (g R), without the square and with the radius, "
        f"{2e3 * jet.speed_m_s / (_WATER.gravity * jet.diameter_mm):.0f}",
    )


def _falls() -> Iterator[Item]:
    """Compute speed and diameter of each jet from the flow through the nozzle."""
    flows = [jet.speed_m_s * jet.diameter_mm**2 for jet in JETS.values()]
    start = float(np.mean(flows)) / NOZZLE_MM**2
    for height, jet in JETS.items():
        speed, diameter = fall(start, NOZZLE_MM, height, _WATER)
        slip, narrower = fall(start, NOZZLE_MM, height * start, _WATER)
        name = f"h = {height} mm: "
        note = f"from {start:.3f} m/s at the nozzle; with 2 g h / V for 2 g h / V^2 "
        yield make_row(f"{name}V_i, m/s", jet.speed_m_s, [speed], f"{note}{slip:.2f}")
        yield make_row(f"{name}D_i, mm", jet.diameter_mm, [diameter], f"{note}{narrower:.2f}")
