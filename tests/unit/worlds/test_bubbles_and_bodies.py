"""Bubbles as they are made: sizes, places, laws of a jet, none in another."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from reproduction.jet_scaling import find_tilt, straighten
from sabench.api import BubbleGenerator
from sabench.api.truth import Bubbles
from sabench.geometry.rigid_motion import Domain
from sabench.plugins import load
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.utils.errors import InputError
from sabench.utils.validation import validate
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.library.overlaps import contact, contains, overlapping, shapes_of
from sabench.worlds.library.plunging_jet import LN2, JetLaw
from sabench.worlds.library.random_packing import place
from sabench.worlds.tracers import Motion, require_flow

DOMAIN = Domain((5.0, -3.0, 60.0), (60.0, 50.0, 40.0), 1000)
JET = Domain((0.0, 90.0, 150.0), (70.0, 176.0, 64.0), 1000)


def generator(name: str, **parameters: object) -> BubbleGenerator:
    plugin = load("generators", name)
    made: BubbleGenerator = plugin(validate(plugin.Parameters, parameters, name))
    return made


def apart_by_points(
    one: np.ndarray,
    axes: np.ndarray,
    turn: np.ndarray,
    other: np.ndarray,
    axes_2: np.ndarray,
    turn_2: np.ndarray,
) -> float:
    """Return the same factor as `contact` by bisection on growing ellipsoids. The second touches
    the first where the nearest of its points is on it."""
    from scipy.optimize import minimize

    def grown(factor: float) -> bool:
        """Return True if the ellipsoids, grown by a factor, have a point in common."""

        def inside(x: np.ndarray) -> float:
            first = np.linalg.norm((turn @ (x - one)) / (factor * axes))
            second = np.linalg.norm((turn_2 @ (x - other)) / (factor * axes_2))
            return float(max(first, second))

        found = minimize(
            inside,
            (one + other) / 2.0,
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000},
        )
        return bool(found.fun < 1.0)

    low, high = 0.01, 100.0
    for _ in range(50):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if grown(middle) else (middle, high)
    return float(high**2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_contact_is_that_of_grown_ellipsoids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rng.uniform(-1.0, 1.0, (2, 3))
    axes, axes_2 = rng.uniform(0.3, 1.5, (2, 3))
    turn, turn_2 = Rotation.random(2, random_state=seed).as_matrix()
    fast = contact(
        one[None],
        shapes_of(axes[None], turn[None]),
        other[None],
        shapes_of(axes_2[None], turn_2[None]),
    )[0]
    assert fast == pytest.approx(apart_by_points(one, axes, turn, other, axes_2, turn_2), rel=1e-4)


def test_a_tenth_of_the_volume_is_filled_and_nothing_overlaps() -> None:
    field = generator(
        "bubble_field", void_fraction=0.1, radius_mm=0.8, aspect_range=[0.5, 1.0], tilt_deg=20.0
    )
    made = field.bubbles(DOMAIN, 3, 0, 0.0)
    assert made.volume_mm3.sum() / DOMAIN.volume_mm3 == pytest.approx(0.1, rel=0.01)
    assert len(overlapping(made)) == 0
    low, high = made.radius_mm.min(), made.radius_mm.max()
    assert low >= 0.1
    assert high <= 4.0
    again = field.bubbles(DOMAIN, 3, 0, 0.0)
    assert_array_equal(made.center_mm, again.center_mm)
    for axis in range(3):
        reach = made.reach_mm(np.eye(3)[axis])
        assert (made.center_mm[:, axis] - reach).min() >= DOMAIN.low_mm[axis] - 1e-9
        assert (made.center_mm[:, axis] + reach).max() <= DOMAIN.low_mm[axis] + DOMAIN.size_mm[
            axis
        ] + 1e-9


def test_overlaps_are_found_whatever_the_sizes() -> None:
    rng = np.random.default_rng(4)
    count = 300
    axes = rng.uniform(0.1, 2.5, (count, 3)) ** 2 / 2.0
    made = Bubbles(
        np.arange(count),
        rng.uniform(-10.0, 10.0, (count, 3)),
        axes,
        Rotation.random(count, random_state=4).as_matrix(),
        np.zeros((count, 3)),
    )
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

    with pytest.raises(InputError, match="spot: expected room for 2 bubbles"):
        place(np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)), propose, "spot")


def test_a_field_moves_as_a_whole() -> None:
    field = generator("bubble_field", count=400, radius_mm=0.5, velocity_mm_s=[0.0, -100.0, 0.0])
    early, late = field.bubbles(DOMAIN, 3, 0, 0.0), field.bubbles(DOMAIN, 3, 1, 0.05)
    both, i, j = np.intersect1d(early.id, late.id, return_indices=True)
    assert len(both) > 300
    assert_allclose(
        late.center_mm[j] - early.center_mm[i], np.tile([0.0, -5.0, 0.0], (len(both), 1)), atol=1e-9
    )
    assert len(late) == pytest.approx(len(early), rel=0.1)
    assert len(overlapping(late)) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("y_p", "d_eq", "angle"), [(211.5, 87.0, 11.6), (160.0, 61.6, 10.9), (120.0, 48.1, 11.3)]
)
def test_the_law_of_jets_is_the_thesis_s(y_p: float, d_eq: float, angle: float) -> None:
    law = JetLaw(y_p, d_eq, 0.003)
    assert law.angle_deg == pytest.approx(angle, abs=0.05)  # table 5.2
    y = np.linspace(1.0, 1.3 * y_p, 40)
    total = np.array(
        [
            2.0
            * np.pi
            * quad(
                lambda r, d=depth: float(law.concentration(np.array(d), np.array(r))),
                0.0,
                500.0,
                limit=400,
            )[0]
            for depth in y
        ]
    )
    assert_allclose(
        total,
        law.largest * law.axis_over_peak(y) * law.half_radius_mm(y) * np.pi**1.5 / np.sqrt(LN2),
        rtol=1e-6,
    )  # 5.22
    scaled = law.scaled_depth(y)
    assert_allclose(
        total / (total / law.total_over_peak(y))[0],
        0.903 * np.exp(-(scaled**2) / (2 * 0.1894**2)) + 0.097,
        rtol=1e-6,
    )  # 5.18
    half = law.half_radius_mm(np.array(y_p))
    assert law.concentration(np.array(y_p), np.array(d_eq / 2.0)) == pytest.approx(
        0.05 * law.concentration(np.array(y_p), np.array(0.0))
    )
    assert law.concentration(np.array(y_p), half) == pytest.approx(
        0.5 * law.concentration(np.array(y_p), np.array(0.0)), rel=1e-5
    )
    slope = 1.1 * np.tan(np.deg2rad(law.angle_deg))

    def ring(r: float, depth: float) -> float:
        return 2.0 * np.pi * r * float(law.concentration(np.array(depth), np.array(r)))

    air = quad(lambda depth: quad(ring, 0.0, slope * depth, args=(depth,))[0], 0.0, y_p, limit=200)[
        0
    ]
    assert air / (np.pi * slope**2 * y_p**3 / 3.0) == pytest.approx(0.003, rel=1e-3)


def test_bubbles_of_a_jet_follow_its_law() -> None:
    """The air in rings of many draws, against the law's integral over the same rings."""
    jet = generator(
        "plunging_jet",
        impact_mm=[0.0, 0.0, 150.0],
        radius_mm=0.3,
        radius_spread=0.3,
        radius_range_mm=[0.15, 0.8],
        overlap=True,
    )
    law = JetLaw(120.0, 48.1, 0.0034)
    edges_y, edges_r = np.linspace(10.0, 170.0, 9), np.array([0.0, 4.0, 8.0, 12.0, 20.0])
    sums = []
    for seed in range(12):
        made = jet.bubbles(JET, seed, 0, 0.0)
        places = made.center_mm - [0.0, 0.0, 150.0]
        sums.append(
            np.histogram2d(
                places[:, 1],
                np.hypot(places[:, 0], places[:, 2]),
                bins=(edges_y, edges_r),
                weights=made.volume_mm3,
            )[0]
        )
    mean, error = np.mean(sums, axis=0), np.std(sums, axis=0, ddof=1) / np.sqrt(len(sums))

    def air(y: float, inner: float, outer: float) -> float:
        depth = np.array(y)
        square = law.half_radius_mm(depth) ** 2
        return float(
            law.air_mm2(depth)
            * (np.exp(-LN2 * inner**2 / square) - np.exp(-LN2 * outer**2 / square))
        )

    expected = np.array(
        [
            [quad(air, *rows, args=ring)[0] for ring in itertools.pairwise(edges_r)]
            for rows in itertools.pairwise(edges_y)
        ]
    )
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
    assert_allclose(
        late.center_mm[j] - early.center_mm[i], early.velocity_mm_s[i] * 1e-3, atol=1e-9
    )
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
    ("name", "parameters", "sentence"),
    [
        ("bubble_field", {}, "expected exactly one of count, void_fraction"),
        ("bubble_field", {"count": 1, "index": 0.9}, "index: .*greater than or equal to 1"),
        (
            "bubble_field",
            {"count": 1, "radius_range_mm": [1.0, 0.5]},
            "radius_range_mm: expected positive",
        ),
        (
            "bubble_field",
            {"count": 1, "aspect_range": [0.5, 1.5]},
            "aspect_range: expected rising values between 0 and 1",
        ),
        ("plunging_jet", {"penetration_mm": 0.0}, "penetration_mm"),
    ],
)
def test_bad_parameters_are_named(name: str, parameters: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        generator(name, **parameters)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"semi_axes_mm": np.zeros((1, 3))}, "semi_axes_mm: expected positive"),
        ({"turn": np.ones((1, 3, 3))}, "turn: expected rotations"),
        ({"center_mm": np.full((1, 3), np.nan)}, "center_mm: expected finite"),
        ({"index": 0.5}, "index: expected 1 or more"),
    ],
)
def test_impossible_bubbles_are_refused(change: dict[str, object], sentence: str) -> None:
    values: dict[str, Any] = {
        "id": np.arange(1),
        "center_mm": np.zeros((1, 3)),
        "semi_axes_mm": np.ones((1, 3)),
        "turn": np.eye(3)[None],
        "velocity_mm_s": np.zeros((1, 3)),
    }
    with pytest.raises(InputError, match=sentence):
        Bubbles(**(values | change))


def coarse(**changes: Any) -> Scene:
    """The reef on a coarse lattice, in few steps."""
    values = load_scene("flow-behind-reef").to_dict()
    values["flow"] |= {"step_mm": 0.8}
    values["solids"][0] |= {"branches": 12, "step_mm": 0.5}
    values["particles"] = {"generator": "uniform", "count": 1500}
    values |= {"frames": 3, "interval_s": 0.2} | changes
    return parse_scene({k: v for k, v in values.items() if v is not None}, "coarse")


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
    solid = coarse().to_dict()["solids"][0]
    moving = coarse(solids=[solid | {"velocity_mm_s": [1.0, 0.0, 0.0]}])
    with pytest.raises(InputError, match=r"expected bodies at rest, but solids\.0 moves"):
        require_flow(moving, 1)
    with pytest.raises(InputError, match="expected solids that it goes around, got none"):
        require_flow(coarse(solids=None, lighting=None, render=None), 1)
