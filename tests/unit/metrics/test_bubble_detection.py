"""Detection and sizes of bubbles."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sabench.api import Detections
from sabench.metrics import counts_per_frame, sauter_mm, size_scores
from sabench.metrics.bubble_detection import (
    AROUND_MM,
    DENSE,
    crowding,
    detection_scores,
    match_bubbles,
    nearest_bubble,
)
from sabench.metrics.plunging_jet import _drop, analyse
from sabench.utils.arrays import F64
from sabench.worlds.library.plunging_jet import EDGE, LN2, JetLaw
from tests.helpers.refusals import refused


def field(count: int = 60, seed: int = 1) -> Detections:
    """Bubbles on a lattice, 10 mm apart."""
    places = 10.0 * np.stack(np.unravel_index(np.arange(count), (4, 5, 4)), axis=1)
    return Detections(
        places.astype(float),
        np.random.default_rng(seed).uniform(0.3, 2.0, (count, 3)),
        Rotation.random(count, random_state=seed).as_matrix(),
    )


def test_the_truth_is_perfect() -> None:
    true = field()
    scores = detection_scores(true, true, np.full(60, 0.5))
    shares = ("f1", "f1_large", "precision", "recall", "recall_hidden")
    lengths = ("radius_percent", "axes_percent", "plane_mm", "depth_mm")
    assert [scores[key] for key in shares] == [1.0] * 5
    for key in (*lengths, "sizes_percent", "void_percent", "tilt_deg"):
        assert scores[key] == pytest.approx(0.0, abs=1e-5)


def test_faults_are_distinguished() -> None:
    true = field()
    found = Detections(
        true.center_mm + np.array([0.02, 0.0, -0.05]), 1.1 * true.semi_axes_mm, true.turn
    )
    scores = detection_scores(found, true, np.ones(60))
    assert scores["plane_mm"] == pytest.approx(0.02)
    assert scores["depth_mm"] == pytest.approx(0.05)
    assert scores["radius_percent"] == scores["axes_percent"] == pytest.approx(10.0)
    assert scores["void_percent"] == pytest.approx(100.0 * (1.1**3 - 1.0))
    assert scores["sizes_percent"] == pytest.approx(10.0)
    assert np.isnan(scores["recall_hidden"])


@pytest.mark.parametrize(("part", "f1"), [(0.49, 1.0), (0.51, 0.0)])
def test_half_a_radius_is_the_limit(part: float, f1: float) -> None:
    true = field()
    moved = true.center_mm + part * true.radius_mm[:, None] * np.array([0.6, 0.0, 0.8])
    found = Detections(moved, true.semi_axes_mm, true.turn)
    assert detection_scores(found, true, np.ones(60))["f1"] == f1


def test_matches_are_one_to_one_and_as_many_as_possible() -> None:
    """The first detection is near both true bubbles, the second only near the first."""
    true, radius = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0]]), np.array([2.0, 2.0])
    i, j = match_bubbles(np.array([[0.5, 0.0, 0.0], [-0.6, 0.0, 0.0]]), true, radius)
    assert {*zip(i.tolist(), j.tolist(), strict=True)} == {(0, 1), (1, 0)}
    assert len(match_bubbles(np.zeros((3, 3)), true, radius)[0]) == 2
    assert len(match_bubbles(np.zeros((0, 3)), true, radius)[0]) == 0


def fine_air(law: JetLaw, depth_mm: float) -> tuple[F64, F64]:
    """Positions and radii of very many equal bubbles with the concentration of a law."""
    rng = np.random.default_rng(7)
    y = np.linspace(0.0, depth_mm, 20001)
    air = law.air_mm2(y)
    depth = np.interp(rng.random(400_000), np.cumsum(air) / air.sum(), y)
    x, z = law.half_radius_mm(depth) / np.sqrt(2.0 * LN2) * rng.standard_normal((2, len(depth)))
    radius = np.cbrt(np.trapezoid(air, y) / len(depth) * 3.0 / (4.0 * np.pi))
    centers = np.column_stack([x, depth, z]) + np.array([3.0, -2.0, 50.0])
    return centers, np.full(len(depth), radius)


def test_no_bin_of_a_jet_is_deeper_than_what_counts() -> None:
    center, radius = np.array([[0.0, 10.0, 0.0]]), np.ones(1)
    found = [analyse(center, radius, np.zeros(3), depth, EDGE) for depth in (199.5, 200.0)]
    assert [float(one.depth_mm[-1]) for one in found] == [170.0, 190.0]
    assert np.isnan([[one.weight, one.width] for one in found]).all()  # one bubble shows no scaling


def test_figures_of_a_jet_are_those_of_its_law() -> None:
    """The law's own means over bins are as expected, though bins blur. Y_p is where they drop."""
    law = JetLaw(120.0, 48.1, 0.0034)
    figures = analyse(*fine_air(law, 200.0), np.array([3.0, -2.0, 50.0]), 200.0, EDGE)
    y, rings = np.linspace(0.0, 200.0, 4001), np.arange(0.0, 81.0, 8.0)
    half = law.half_radius_mm(y)
    bins = [(y >= low) & (y <= low + 20.0) for low in np.arange(0.0, 200.0, 20.0)]
    for ring, (inner, outer) in enumerate(itertools.pairwise(rings[:5])):
        shares = [-np.expm1(-LN2 * r**2 / half**2) for r in (inner, outer)]
        air = law.air_mm2(y) * (shares[1] - shares[0])
        expected = [np.trapezoid(air[part], y[part]) for part in bins]
        room = np.pi * (outer**2 - inner**2) * 20.0
        found = figures.concentration[:, ring]
        assert_allclose(found, np.array(expected) / room, rtol=0.1, atol=2e-5)
    assert figures.penetration_mm == pytest.approx(120.0, rel=0.1)
    assert figures.angle_deg == pytest.approx(law.angle_deg, rel=0.25)
    assert figures.weight == pytest.approx(0.903, rel=0.1)
    assert figures.width == pytest.approx(0.1894, rel=0.25)
    # at 90 mm the concentration is c exp(-ln 2 r^2 / R^2), and C_Y its integral over r times 2 pi
    radius, air90 = (float(part(np.array([90.0]))[0]) for part in (law.half_radius_mm, law.air_mm2))
    largest = air90 * LN2 / (np.pi * radius**2)
    assert figures.total[4] == pytest.approx(np.pi**1.5 * largest * radius / np.sqrt(LN2), rel=0.15)
    assert figures.half_radius_mm[4] == pytest.approx(radius, rel=0.2)
    assert_array_equal(figures.largest[:6], figures.concentration[:6, 0])
    # air in a cone a tenth wider than the cloud at its end
    slope, end = 1.1 * np.tan(np.deg2rad(figures.angle_deg)), figures.penetration_mm
    above = y <= end
    air = (law.air_mm2(y) * -np.expm1(-LN2 * (slope * y) ** 2 / half**2))[above]
    cone = np.pi * slope**2 * end**3 / 3.0
    expected = 100.0 * np.trapezoid(air, y[above]) / cone
    assert figures.cone_percent == pytest.approx(expected, rel=0.02)


def test_false_detections_belong_to_the_bubble_that_they_are_in() -> None:
    """The small bubble's centre is nearer to a point within the large one."""
    true = Detections.balls(np.array([[0.0, 0.0, 0.0], [2.5, 0.0, 0.0]]), np.array([2.0, 0.3]))
    points = np.array([[1.9, 0.0, 0.0], [2.3, 0.0, 0.0], [-30.0, 0.0, 0.0], [40.0, 0.0, 0.0]])
    assert_array_equal(nearest_bubble(true, points), [0, 1, 0, 1])
    none = Detections.balls(np.zeros((0, 3)), np.zeros(0))
    scores = detection_scores(true, none, np.zeros(0))
    assert scores["f1"] == 0.0
    assert np.isnan(scores["f1_large"])


def test_small_ones_and_those_among_many_are_counted_apart() -> None:
    """Three of five bubbles are a crowd that fills 2 (1 / 6)^3 around each."""
    places = np.zeros((5, 3))
    places[1:, 0], places[2, 1] = [2.5, 0.0, 40.0, 80.0], 2.5
    true = Detections.balls(places, np.array([1.0, 1.0, 1.0, 1.0, 0.2]))
    assert_allclose(crowding(true), np.array([2.0, 2.0, 2.0, 0.0, 0.0]) / 216.0, atol=1e-15)
    larger = Detections.balls(places, np.array([1.1, 1.1, 1.1, 1.0, 0.2]))
    found = Detections.balls(places[[0, 3]], np.array([1.1, 1.0]))
    scores = detection_scores(found, larger, np.ones(5))
    assert scores["recall_dense"] == pytest.approx(1.0 / 3.0)
    assert scores["f1_small"] == 0.0
    assert scores["f1_large"] == pytest.approx(2.0 / 3.0)
    alone = Detections.balls(places[3:4], np.ones(1))
    assert np.isnan(detection_scores(found, alone, np.ones(1))["recall_dense"])


@pytest.mark.parametrize("dense", [True, False])
def test_a_place_is_dense_from_its_void_fraction_on(dense: bool) -> None:
    """A neighbour of exactly this share of the ball makes a place dense, a smaller one does not."""
    share = DENSE * AROUND_MM**3 * np.nextafter(1.0, 0.0)  # its share is rounded to the limit
    places = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    axes = np.array([[1.0, 1.0, share * (1.0 if dense else 1.0 - 1e-12)]] * 3)
    turn = np.tile(np.eye(3), (3, 1, 1))
    true = Detections(places, axes, turn)
    assert (crowding(true)[0] == DENSE) == dense
    assert crowding(true)[0] == pytest.approx(DENSE, rel=1e-11)
    found = Detections(places[:1], axes[:1], turn[:1])
    recall = detection_scores(found, true, np.ones(3))["recall_dense"]
    assert recall == 0.5 if dense else np.isnan(recall)


@pytest.mark.parametrize("count", [40, 57])
def test_the_distance_is_the_area_between_both_distribution_functions(count: int) -> None:
    rng = np.random.default_rng(3)
    own, true = rng.lognormal(-0.7, 0.5, count), rng.lognormal(-0.8, 0.55, 57)
    scores = size_scores(own, true)
    ends = np.sort(np.concatenate([own, true]))
    first, second = (
        np.searchsorted(np.sort(part), ends[:-1], side="right") / len(part) for part in (own, true)
    )
    area = np.sum(np.abs(first - second) * np.diff(ends))
    assert scores["sizes_mm"] == pytest.approx(area, rel=1e-9)
    assert scores["sizes_percent"] == pytest.approx(100.0 * scores["sizes_mm"] / true.mean())
    if count == len(true):  # mean difference of equal ranks
        ranks = np.abs(np.sort(own) - np.sort(true)).mean()
        assert scores["sizes_mm"] == pytest.approx(ranks, rel=1e-9)


def test_scores_of_known_faults() -> None:
    true = np.array([0.2, 0.5, 1.0])
    larger = size_scores(1.1 * true, true)
    for key in ("sizes_percent", "mean_percent", "sauter_percent"):
        assert larger[key] == pytest.approx(10.0)
    twice = size_scores(np.concatenate([true, true]), true)
    assert max(twice.values()) == pytest.approx(0.0, abs=1e-9)  # sizes, not numbers
    assert size_scores(true[2:], true)["sizes_mm"] == pytest.approx((0.8 + 0.5) / 3.0)
    assert all(np.isnan(value) for value in size_scores(np.zeros(0), true).values())


def test_d32_is_three_times_volume_over_surface() -> None:
    radius = np.random.default_rng(1).uniform(0.1, 2.0, 50)
    volume, surface = np.sum(4.0 / 3.0 * np.pi * radius**3), np.sum(4.0 * np.pi * radius**2)
    assert sauter_mm(radius) == pytest.approx(6.0 * volume / surface)
    assert sauter_mm(np.full(7, 0.4)) == pytest.approx(0.8)
    assert np.isnan(sauter_mm(np.zeros(0)))


def test_intervals_hold_the_mean_of_the_distribution_as_often_as_they_say() -> None:
    rng = np.random.default_rng(5)
    edges, held = np.array([0.0, 0.5, 1.0]), []
    for _ in range(400):
        frames = [rng.uniform(0.0, 1.0, rng.poisson(40.0)) for _ in range(10)]
        held += [
            abs(m.mean - 20.0) <= (m.half_width or 0.0) for m in counts_per_frame(frames, edges)
        ]
    assert np.mean(held) == pytest.approx(0.95, abs=0.03)
    with refused(kind=ValueError):
        counts_per_frame([], edges)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_the_cloud_ends_where_it_falls_most_and_not_where_bubbles_are_few(scale: float) -> None:
    total = scale * np.array([0.0, 4.0, 10.0, 8.0, 6.0, 5.0, 0.9, 0.1, 0.0, 0.0])
    assert _drop(total) == 6  # 5 -> 0.9; from 0.9 on, it is less than a fifth of the peak
    assert _drop(total[::-1]) == 9
    assert _drop(0.0 * total) is None
    assert _drop(total[:3]) is None  # the peak is the last bin
