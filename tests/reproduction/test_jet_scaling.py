"""Scaling laws, prediction and tilt of jets, on bubbles and figures made from known laws."""

from __future__ import annotations

import numpy as np
import pytest

from reproduction.jet_scaling import (
    TOTAL,
    FivePoints,
    explained_share,
    find_tilt,
    five_points,
    radial_slope,
    slopes,
    straighten,
    total_factor,
)
from sabench.metrics.plunging_jet import JetFigures, analyse, fit_total
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import EDGE, LN2, JetLaw

LAW = FivePoints(0.002, 0.05, 90.0, 6.0, 120.0)


def figures(law: FivePoints, step: float = 2.0) -> JetFigures:
    """Sample a law at depths and radii, as finely as asked for."""
    y, r = np.arange(step / 2.0, 180.0, step), np.arange(step / 8.0, 60.0, step / 4.0)
    nearest = int(np.abs(y - law.peak_mm).argmin())
    y = y + law.peak_mm - y[nearest]
    c = law.concentration(y[:, None], r[None])
    total = 2.0 * np.pi * c.sum(axis=1) * step / 4.0
    half = law.total(y) / (TOTAL * law.on_axis(y))
    nan = float("nan")
    return JetFigures(y, r, c, total, law.on_axis(y), half, law.penetration_mm, *([nan] * 5))


def test_laws_are_found_again() -> None:
    jet = figures(LAW)
    assert slopes([jet]) == pytest.approx((2.21, -2.87), rel=0.01)
    assert radial_slope(jet) == pytest.approx(LN2, rel=1e-3)
    assert total_factor(jet) == pytest.approx(TOTAL, rel=2e-3)
    scaled = LAW.scaled_depth(jet.depth_mm)
    assert fit_total(scaled, jet.total / jet.total.max()) == pytest.approx(
        (0.903, 0.1894), rel=5e-3
    )


def test_equation_5_22_is_the_integral_of_5_19() -> None:
    """C_Y = 2 pi times the integral of C over R from 0, by quadrature."""
    r = np.linspace(0.0, 100.0, 200_001)
    for y in (40.0, 90.0, 110.0):
        there = 2.0 * np.pi * np.trapezoid(LAW.concentration(np.array(y), r), r)
        assert there == pytest.approx(float(LAW.total(np.array(y))), rel=1e-6)


def test_five_points_predict_the_whole_field() -> None:
    jet = figures(LAW)
    points = five_points(jet)
    assert points.peak_mm == pytest.approx(90.0)
    assert explained_share(points, jet) == pytest.approx(1.0, abs=1e-3)
    wrong = FivePoints(0.002, 0.05, 50.0, 6.0, 120.0)
    assert explained_share(wrong, jet) < 0.8
    with pytest.raises(ValueError, match="penetration depth"):
        five_points(analyse(np.zeros((0, 3)), np.zeros(0), np.zeros(3), 100.0, EDGE))


def cloud(seed: int, count: int) -> F64:
    """Draw bubbles (n, 3) of a jet along +Y from the origin, wider with depth."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(5.0, 170.0, count)
    return np.column_stack(
        [0.1 * y * rng.standard_normal(count), y, 0.1 * y * rng.standard_normal(count)]
    )


def test_a_tilt_is_found_within_its_statistical_error_and_removed() -> None:
    """A bubble's direction scatters by 0.1 rad: n of them give the axis to 0.1 / sqrt(n)."""
    impact, tilt, count = np.array([3.0, -2.0, 150.0]), (1.5, -0.7), 1500
    own = []
    for seed in range(20):
        upright = cloud(seed, count)
        tilted = straighten(upright, np.zeros(3), (0.0, 0.0)) + impact
        back = straighten(
            tilted, impact, tilt
        )  # rotates by the inverse: a jet tilted the other way
        own.append(find_tilt(back, impact))
    mean, scatter = np.mean(own, axis=0), np.std(own, axis=0, ddof=1)
    expected = np.rad2deg(0.1 / np.sqrt(count))
    assert mean == pytest.approx((-1.5, 0.7), abs=4.0 * expected / np.sqrt(20))
    assert scatter == pytest.approx(expected, rel=0.6)


def test_a_straightened_jet_is_upright() -> None:
    impact = np.array([3.0, -2.0, 150.0])
    axis = np.array([np.tan(np.deg2rad(1.5)), 1.0, np.tan(np.deg2rad(-0.7))])
    points = impact + np.linspace(1.0, 160.0, 40)[:, None] * axis
    assert find_tilt(points + 1e-6, impact) == pytest.approx((1.5, -0.7), abs=1e-4)
    moved = straighten(points, impact, (1.5, -0.7)) - impact
    assert moved[:, [0, 2]] == pytest.approx(np.zeros((40, 2)), abs=1e-9)
    assert np.linalg.norm(moved, axis=1) == pytest.approx(np.linalg.norm(points - impact, axis=1))
    with pytest.raises(ValueError, match="expected 5 bubbles"):
        find_tilt(points[:3], impact)


def test_the_air_of_the_cone_is_that_of_the_law() -> None:
    """C_tot of bubbles drawn with equal volumes at the law's depths and radii."""
    law = JetLaw(120.0, 48.1, 0.0034)
    rng, count = np.random.default_rng(2), 200_000
    y = np.linspace(0.0, 120.0, 4001)
    air = law.air_mm2(y)
    cumulated = np.concatenate([[0.0], np.cumsum(0.5 * (air[1:] + air[:-1]) * np.diff(y))])
    depth = np.interp(rng.random(count) * cumulated[-1], cumulated, y)
    spread = law.half_radius_mm(depth) / np.sqrt(2.0 * LN2)
    x, z = spread * rng.standard_normal((2, count))
    radius = np.full(count, np.cbrt(cumulated[-1] / count * 3.0 / (4.0 * np.pi)))
    jet = analyse(np.column_stack([x, depth, z]), radius, np.zeros(3), 180.0, EDGE)
    assert jet.penetration_mm == pytest.approx(120.0)
    slope = 1.1 * np.tan(np.deg2rad(jet.angle_deg))
    part = -np.expm1(-LN2 * (slope * y) ** 2 / law.half_radius_mm(y) ** 2)
    inside = np.trapezoid(air * part, y) / (np.pi * slope**2 * 120.0**3 / 3.0)
    assert jet.cone_percent == pytest.approx(100.0 * inside, rel=0.01)
