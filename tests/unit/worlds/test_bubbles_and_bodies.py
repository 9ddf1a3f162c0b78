"""Bubbles as they are made: sizes, places, laws of a jet, none in another."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from reproduction.jet_scaling import find_tilt, straighten
from sabench.api import BubbleGenerator
from sabench.api.make import generator_of
from sabench.api.truth import Bubbles
from sabench.geometry.rigid_motion import Domain
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.arrays import F64
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.library.overlaps import contact, contains, overlapping, shapes_of
from sabench.worlds.library.plunging_jet import LN2, JetLaw
from sabench.worlds.library.random_packing import place_ellipsoids
from sabench.worlds.tracers import Motion, require_flow
from tests.helpers.refusals import refused

DOMAIN = Domain((5.0, -3.0, 60.0), (60.0, 50.0, 40.0), 1000)
JET = Domain((0.0, 90.0, 150.0), (70.0, 176.0, 64.0), 1000)


def generator(name: str, **parameters: object) -> BubbleGenerator:
    made: BubbleGenerator = generator_of({"generator": name, **parameters})
    return made


def apart_by_points(centers: F64, axes: F64, turns: F64) -> float:
    """The same factor as `contact`, by a search for the point nearest to both ellipsoids."""

    def factor(x: F64) -> float:
        parts = zip(centers, axes, turns, strict=True)
        return float(max(np.linalg.norm(turn @ (x - at) / axis) for at, axis, turn in parts))

    options: dict[str, Any] = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 4000}
    least = minimize(factor, centers.mean(axis=0), method="Nelder-Mead", options=options).fun
    return float(least) ** 2


@pytest.mark.parametrize("seed", [1, 2])
def test_contact_is_that_of_grown_ellipsoids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centers, axes = rng.uniform(-1.0, 1.0, (2, 3)), rng.uniform(0.3, 1.5, (2, 3))
    turns = Rotation.random(2, random_state=seed).as_matrix()
    one, other = (shapes_of(axes[k : k + 1], turns[k : k + 1]) for k in (0, 1))
    fast = contact(centers[:1], one, centers[1:], other)[0]
    assert fast == pytest.approx(apart_by_points(centers, axes, turns), rel=1e-4)


def test_a_tenth_of_the_volume_is_filled_and_nothing_overlaps() -> None:
    shape = {"radius_mm": 0.8, "aspect_range": [0.5, 1.0], "tilt_deg": 20.0}
    field = generator("bubble_field", void_fraction=0.1, **shape)
    made = field.bubbles(DOMAIN, 3, 0, 0.0)
    assert made.volume_mm3.sum() / DOMAIN.volume_mm3 == pytest.approx(0.1, rel=0.01)
    assert len(overlapping(made)) == 0
    assert 0.1 <= made.radius_mm.min() <= made.radius_mm.max() <= 4.0
    assert_array_equal(made.center_mm, field.bubbles(DOMAIN, 3, 0, 0.0).center_mm)
    reach = np.column_stack([made.reach_mm(axis) for axis in np.eye(3)])
    low = np.asarray(DOMAIN.low_mm)
    assert (made.center_mm - reach >= low - 1e-9).all()
    assert (made.center_mm + reach <= low + DOMAIN.size_mm + 1e-9).all()


def test_overlaps_are_found_whatever_the_sizes() -> None:
    rng = np.random.default_rng(4)
    count = 300
    axes = rng.uniform(0.1, 2.5, (count, 3)) ** 2 / 2.0
    places = rng.uniform(-10.0, 10.0, (count, 3))
    turns = Rotation.random(count, random_state=4).as_matrix()
    made = Bubbles(np.arange(count), places, axes, turns, np.zeros((count, 3)))
    i, j = np.triu_indices(count, 1)
    shapes = shapes_of(made.semi_axes_mm, made.turn)
    every = contact(made.center_mm[i], shapes[i], made.center_mm[j], shapes[j]) < 1.0 - 1e-9
    expected = {frozenset(pair) for pair in zip(i[every].tolist(), j[every].tolist(), strict=True)}
    found = overlapping(made)
    assert {frozenset(pair) for pair in found.tolist()} == expected
    assert len(expected) > 50
    largest = made.semi_axes_mm.max(axis=1)
    assert (largest[found[:, 0]] >= largest[found[:, 1]]).all()


def test_no_room_is_said() -> None:
    def propose(which: np.ndarray, tries: int) -> np.ndarray:
        return np.zeros((len(which), tries, 3))

    with refused("spot", "2"):
        place_ellipsoids(np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)), propose, "spot")


def test_a_field_moves_as_a_whole() -> None:
    field = generator("bubble_field", count=400, radius_mm=0.5, velocity_mm_s=[0.0, -100.0, 0.0])
    early, late = field.bubbles(DOMAIN, 3, 0, 0.0), field.bubbles(DOMAIN, 3, 1, 0.05)
    both, i, j = np.intersect1d(early.id, late.id, return_indices=True)
    assert len(both) > 300
    expected = np.tile([0.0, -5.0, 0.0], (len(both), 1))
    assert_allclose(late.center_mm[j] - early.center_mm[i], expected, atol=1e-9)
    assert len(late) == pytest.approx(len(early), rel=0.1)
    assert len(overlapping(late)) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("y_p", "d_eq", "angle"), [(211.5, 87.0, 11.6), (120.0, 48.1, 11.3)])
def test_the_law_of_jets_is_the_thesis_s(y_p: float, d_eq: float, angle: float) -> None:
    law = JetLaw(y_p, d_eq, 0.003)
    assert law.angle_deg == pytest.approx(angle, abs=0.05)  # table 5.2

    def ring(r: float, depth: float) -> float:
        return 2.0 * np.pi * r * float(law.concentration(np.array(depth), np.array(r)))

    def line(r: float, depth: float) -> float:
        return 2.0 * np.pi * float(law.concentration(np.array(depth), np.array(r)))

    y = np.linspace(1.0, 1.3 * y_p, 40)
    total = np.array([quad(line, 0.0, 500.0, args=(depth,), limit=400)[0] for depth in y])
    peak = law.largest * law.axis_over_peak(y) * law.half_radius_mm(y)
    assert_allclose(total, peak * np.pi**1.5 / np.sqrt(LN2), rtol=1e-6)  # 5.22
    found = total / (total / law.total_over_peak(y))[0]
    bell = np.exp(-(law.scaled_depth(y) ** 2) / (2 * 0.1894**2))
    assert_allclose(found, 0.903 * bell + 0.097, rtol=1e-6)  # 5.18
    radii = np.array([0.0, float(law.half_radius_mm(np.array(y_p))), d_eq / 2.0])
    across = law.concentration(np.array(y_p), radii)
    assert_allclose(across / across[0], [1.0, 0.5, 0.05], rtol=1e-5)
    slope = 1.1 * np.tan(np.deg2rad(law.angle_deg))
    air = quad(lambda y: quad(ring, 0.0, slope * y, args=(y,))[0], 0.0, y_p, limit=200)[0]
    assert air / (np.pi * slope**2 * y_p**3 / 3.0) == pytest.approx(0.003, rel=1e-3)


@pytest.mark.slow
def test_bubbles_of_a_jet_follow_its_law() -> None:
    """The air in rings of many draws, against the law's integral over the same rings."""
    sizes = {"radius_mm": 0.3, "radius_spread": 0.3, "radius_range_mm": [0.15, 0.8]}
    jet = generator("plunging_jet", impact_mm=[0.0, 0.0, 150.0], overlap=True, **sizes)
    law = JetLaw(120.0, 48.1, 0.0034)
    bins = np.linspace(10.0, 170.0, 9), np.array([0.0, 4.0, 8.0, 12.0, 20.0])
    sums = []
    for seed in range(12):
        made = jet.bubbles(JET, seed, 0, 0.0)
        x, y, z = (made.center_mm - [0.0, 0.0, 150.0]).T
        sums.append(np.histogram2d(y, np.hypot(x, z), bins=bins, weights=made.volume_mm3)[0])
    mean, error = np.mean(sums, axis=0), np.std(sums, axis=0, ddof=1) / np.sqrt(len(sums))

    def air(y: float, *ring: float) -> float:
        depth = np.array(y)
        inner, outer = np.exp(-LN2 * np.square(ring) / law.half_radius_mm(depth) ** 2)
        return float(law.air_mm2(depth) * (inner - outer))

    depths, rings = ([*itertools.pairwise(edges)] for edges in bins)
    expected = np.array([[quad(air, *rows, args=ring)[0] for ring in rings] for rows in depths])
    score = (mean - expected) / np.maximum(error, 0.02 * expected.max())
    assert np.abs(score).max() < 5.0
    assert (score**2).mean() < 2.5
    below = made.center_mm[:, 1] > 120.0
    assert below.any()
    assert made.radius_mm[below].max() <= 0.525


def test_a_jet_sinks_on_its_axis_and_rises_beside_it() -> None:
    jet = generator("plunging_jet", impact_mm=[0.0, 0.0, 150.0])
    early, late = jet.bubbles(JET, 1, 0, 0.0), jet.bubbles(JET, 1, 1, 1e-3)
    _, i, j = np.intersect1d(early.id, late.id, return_indices=True)
    expected = early.velocity_mm_s[i] * 1e-3
    assert_allclose(late.center_mm[j] - early.center_mm[i], expected, atol=1e-9)
    radius = np.hypot(early.center_mm[:, 0], early.center_mm[:, 2] - 150.0)
    shallow = early.center_mm[:, 1] < 80.0
    assert early.velocity_mm_s[shallow & (radius < 3.0), 1].min() > 0.0
    assert (early.velocity_mm_s[radius > 20.0, 1] < 0.0).all()
    assert len(overlapping(late)) == 0


def test_an_inclined_jet_is_the_upright_one_about_another_axis() -> None:
    """With overlaps and far from the sides, the same draws are rotated about the impact."""
    wide = Domain((0.0, 100.0, 0.0), (400.0, 200.0, 400.0), 1000)
    upright, inclined = (
        generator("plunging_jet", inclination_deg=tilt, overlap=True).bubbles(wide, 3, 0, 0.0)
        for tilt in ([0.0, 0.0], [1.5, -0.7])
    )
    back = straighten(inclined.center_mm, np.zeros(3), (1.5, -0.7))
    distance, _ = cKDTree(back).query(upright.center_mm)
    assert np.mean(distance < 1e-9) > 0.9  # the others were beyond a side in one of both
    assert find_tilt(upright.center_mm, np.zeros(3)) == pytest.approx((0.0, 0.0), abs=0.7)
    assert find_tilt(inclined.center_mm, np.zeros(3)) == pytest.approx((1.5, -0.7), abs=0.7)


@pytest.mark.parametrize(
    ("name", "parameters", "key"),
    [
        ("bubble_field", {}, "count, void_fraction"),
        ("bubble_field", {"count": 1, "index": 0.9}, "index: "),
        ("bubble_field", {"count": 1, "radius_range_mm": [1.0, 0.5]}, "radius_range_mm: "),
        ("bubble_field", {"count": 1, "aspect_range": [0.5, 1.5]}, "aspect_range: "),
        ("plunging_jet", {"penetration_mm": 0.0}, "penetration_mm: "),
    ],
)
def test_bad_parameters_are_named(name: str, parameters: dict[str, object], key: str) -> None:
    with refused(key):
        generator(name, **parameters)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("semi_axes_mm", np.zeros((1, 3))),
        ("turn", np.ones((1, 3, 3))),
        ("center_mm", np.full((1, 3), np.nan)),
        ("index", 0.5),
    ],
)
def test_impossible_bubbles_are_refused(key: str, value: Any) -> None:
    one = Bubbles(
        np.arange(1), np.zeros((1, 3)), np.ones((1, 3)), np.eye(3)[None], np.zeros((1, 3))
    )
    with refused(f"{key}: "):
        replace(one, **{key: value})


def coarse(**changes: Any) -> Scene:
    values = load_scene("flow-behind-reef").to_dict()
    values["flow"] |= {"step_mm": 0.8}
    values["solids"][0] |= {"branches": 12, "step_mm": 0.5}
    values["particles"] = {"generator": "uniform", "count": 1500}
    values |= {"frames": 3, "interval_s": 0.2} | changes
    return parse_scene({k: v for k, v in values.items() if v is not None}, "coarse")


@pytest.mark.slow
def test_no_tracer_that_starts_outside_ends_in_the_body() -> None:
    """Over 4 mm of mean flow, a tenth of the mean distance through the reef would show."""
    scene = coarse()
    body = Phases(scene, 1).bodies(0)[0][0]
    motion = Motion(scene, 1)
    first, last = motion.at(0), motion.at(2)
    _, i, j = np.intersect1d(first.id, last.id, return_indices=True)
    outside = ~contains(body, first.position_mm[i])
    moved = np.linalg.norm(last.position_mm[j] - first.position_mm[i], axis=1)
    assert np.median(moved[outside]) > 2.0
    assert contains(body, last.position_mm[j][outside]).sum() <= 0.01 * outside.sum()
    assert np.median(moved[~outside]) < 0.5


def test_flow_is_of_the_bodies_of_the_seed() -> None:
    scene = coarse()
    point = np.array([[-2.0, 3.0, 0.0]])
    one, same, other = (require_flow(scene, seed).velocity(point, 0.0) for seed in (1, 1, 2))
    assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1e-3


def test_bodies_that_move_and_missing_bodies_are_refused() -> None:
    moving = coarse(solids=[coarse().to_dict()["solids"][0] | {"velocity_mm_s": [1.0, 0.0, 0.0]}])
    with refused("solids.0"):
        require_flow(moving, 1)
    with refused("solids"):
        require_flow(coarse(solids=None, lighting=None, render=None), 1)
