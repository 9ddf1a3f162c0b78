"""Surfaces of solid bodies. Closed, of the right size, and not spoilt by the lattice."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.spatial import cKDTree

from sabench.api.make import generator_of
from sabench.api.truth import Solid
from sabench.scenes import build_rig
from sabench.simulation.frames import Frames
from sabench.utils.arrays import F64
from sabench.worlds.library.implicit_surfaces import (
    capsules,
    largest_part,
    smooth_minimum,
    surface_of,
)
from tests.helpers.bubble_scenes import small
from tests.helpers.refusals import refused

BODIES: list[tuple[str, dict[str, Any]]] = [
    ("hydrofoil", {"digits": "0030", "points": 8}),
    ("propeller", {"step_mm": 0.5, "blades": 3, "pitch_mm": -20.0, "diameter_mm": 25.0}),
    ("reef", {"step_mm": 0.6}),
    ("reef", {"step_mm": 0.6, "tunnels": 0, "size_mm": [20.0, 30.0, 24.0]}),
]


def body(name: str, seed: int = 1, **parameters: object) -> Solid:
    made: Solid = generator_of({"generator": name, **parameters}).body(seed)
    return made


def volume(solid: Solid) -> float:
    """What a closed surface encloses, by Gauss's theorem; negative if it faces inwards."""
    return float(np.linalg.det(solid.vertices_mm[solid.faces]).sum() / 6.0)


def area(solid: Solid) -> float:
    a, b, c = np.moveaxis(solid.vertices_mm[solid.faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def characteristic(solid: Solid) -> int:
    """Euler's: 2 for a ball, 2 less for each handle."""
    return len(np.unique(solid.faces)) - len(solid.faces) // 2


@pytest.mark.slow_but_first
@pytest.mark.parametrize(("name", "parameters"), BODIES)
def test_bodies_are_one_closed_surface(name: str, parameters: dict[str, Any]) -> None:
    made = body(name, **parameters)
    edges = np.concatenate([made.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    assert len(np.unique(edges, axis=0)) == len(edges)  # every edge once ...
    there, back = ({*map(tuple, one.tolist())} for one in (edges, edges[:, ::-1]))
    assert there == back  # ... and once the other way round
    assert volume(made) > 0.0
    assert len(largest_part(made).faces) == len(made.faces)
    table = {"generator": name, "place_mm": [0.0, 0.0, 60.0], **parameters}
    scene = small(bubbles=None, solids=[table])
    (placed,) = Frames(scene, build_rig(scene), 1).at(0).solids
    assert_array_equal(placed.faces, made.faces)
    assert_allclose(placed.vertices_mm, made.vertices_mm + np.array([0.0, 0.0, 60.0]))


@pytest.mark.parametrize(
    ("digits", "height", "place", "ratio"),
    [("0012", 0.0, 0.5, 0.12), ("2412", 0.02, 0.4, 0.12), ("6721", 0.06, 0.7, 0.21)],
)
def test_a_wing_has_its_section(digits: str, height: float, place: float, ratio: float) -> None:
    """A section's area is twice the integral of half the thickness along its mean line."""
    powers = np.polynomial.Polynomial([0.0, -0.126, -0.3516, 0.2843, -0.1036])

    def strip(x: float) -> float:
        half = 5.0 * ratio * (0.2969 * np.sqrt(x) + powers(x))
        slope = 2.0 * height / (place if x < place else 1.0 - place) ** 2 * (place - x)
        return float(2.0 * half * np.hypot(1.0, slope))

    exact = 20.0**2 * 40.0 * (quad(strip, 0.0, place)[0] + quad(strip, place, 1.0)[0])
    made = [body("hydrofoil", digits=digits, points=points) for points in (100, 200, 400)]
    off = [abs(volume(one) / exact - 1.0) for one in made]
    assert off[-1] < 2e-4
    assert off[1] < off[0] / 3.5
    x, y, z = body("hydrofoil", digits=digits).vertices_mm.T
    assert_allclose(np.unique(y), [-20.0, 20.0])
    tail = x > 15.0 - 1e-9  # the chord is 20 mm long, a quarter of it in front of the origin
    assert_allclose(x[tail], [15.0, 15.0], atol=1e-9)
    assert_allclose(z[tail], 0.0, atol=1e-9)  # closed
    assert z.max() >= -z.min() - 1e-9  # the upper side is +Z


def ball(points: F64) -> F64:
    return np.asarray(np.linalg.norm(points - [0.1, 0.2, -0.3], axis=1) - 2.0)


def capsule(points: F64) -> F64:
    ends = np.array([[-2.0, 0.3, 0.1]]), np.array([[1.5, 0.3, 0.1]])
    return capsules(points, *ends, np.ones(1), np.ones(1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "radius", "inside", "outside"),
    [(ball, 2.0, 32.0 / 3.0, 16.0), (capsule, 1.0, 4.0 / 3.0 + 3.5, 11.0)],
)
def test_surfaces_are_exact_to_the_second_order(
    function: Callable[[F64], F64], radius: float, inside: float, outside: float
) -> None:
    """Triangles are off by at most 3/8 step^2 / radius: an arc's height over a cell's diagonal."""
    made = [surface_of(function, [-4.0, -3.0, -3.0], [4.0, 3.0, 3.0], step) for step in (0.3, 0.15)]
    for measure, exact in ((volume, np.pi * inside), (area, np.pi * outside)):
        coarse, fine = (abs(measure(one) / exact - 1.0) for one in made)
        assert coarse < 3.0 * 3.0 / 8.0 * (0.3 / radius) ** 2
        assert coarse / 4.5 < fine < coarse / 3.5


def test_distances_to_cones_are_those_of_all_their_balls() -> None:
    rng = np.random.default_rng(5)
    starts, ends = rng.uniform(-1.0, 1.0, (2, 6, 3))
    first, last = rng.uniform(0.1, 0.9, (2, 6))
    ends[0], last[1] = starts[0], first[1] + 9.0  # a ball, and one that holds the other
    points, cones = rng.uniform(-3.0, 3.0, (40, 3)), (starts, ends, first, last)
    share = np.linspace(0.0, 1.0, 20001)[:, None]

    def least(point: F64, k: int) -> float:
        balls = starts[k] + share * (ends[k] - starts[k])
        radii = first[k] + share[:, 0] * (last[k] - first[k])
        return float((np.linalg.norm(point - balls, axis=1) - radii).min())

    alone = np.array([capsules(points, *(part[k : k + 1] for part in cones)) for k in range(6)])
    assert_allclose(alone, [[least(point, k) for point in points] for k in range(6)], atol=1e-7)
    some = [0, 2, 3, 4, 5]
    chosen = [part[some] for part in cones]
    every = capsules(points, *chosen)
    assert_allclose(every, alone[some].min(axis=0), atol=1e-12)
    heads, tails, thick, thin = chosen
    blended = capsules(points, heads, tails, thick, thin, blend_mm=0.2)
    assert_allclose(blended, smooth_minimum(alone[some], 0.2), atol=1e-4)
    assert (blended < every).all()
    assert (capsules(points, *(part[:0] for part in cones)) == np.inf).all()


def test_a_smooth_minimum_is_between_its_bounds_in_any_order() -> None:
    values = np.random.default_rng(2).normal(size=(5, 200))
    soft = smooth_minimum(values, 0.3)
    assert (soft <= values.min(axis=0)).all()
    assert (soft >= values.min(axis=0) - 0.3 * np.log(5.0)).all()
    assert_allclose(smooth_minimum([smooth_minimum(values[3:], 0.3), *values[:3]], 0.3), soft)
    assert_array_equal(smooth_minimum(values, 0.0), values.min(axis=0))
    assert_allclose(smooth_minimum(np.full((4, 1), 100.0), 1e-3), 100.0 - 1e-3 * np.log(4.0))


def test_hollows_are_filled_and_islands_gone() -> None:
    def shell_and_island(points: F64) -> F64:
        radius = np.linalg.norm(points, axis=1)
        island = np.linalg.norm(points - [2.8, 0.0, 0.0], axis=1) - 0.5
        return np.asarray(np.minimum(np.abs(radius - 1.5) - 0.4, island))

    every = surface_of(shell_and_island, [-4.0] * 3, [4.0] * 3, 0.1)
    assert volume(every) == pytest.approx(4.0 / 3.0 * np.pi * (1.9**3 - 1.1**3 + 0.5**3), rel=0.01)
    whole = largest_part(every)
    assert volume(whole) == pytest.approx(4.0 / 3.0 * np.pi * 1.9**3, rel=0.01)
    assert characteristic(whole) == 2
    assert np.array_equal(np.unique(whole.faces), np.arange(len(whole.vertices_mm)))


def test_planes_through_nodes_leave_no_flat_triangles() -> None:
    box = surface_of(lambda p: np.abs(p).max(axis=1) - 1.0, [-2.0] * 3, [2.0] * 3, 0.25)
    a, b, c = np.moveaxis(box.vertices_mm[box.faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0.0
    expected = 8.0 - 12.0 * 1.5 * 0.25**2 / 2.0 - 8.0 * 0.25**3 * 5.0 / 6.0
    assert volume(box) == pytest.approx(expected, rel=1e-3)  # edges and corners are cut


@pytest.mark.parametrize(
    ("low", "high", "step", "key"),
    [
        (-2.0, 2.0, 1e-3, "step_mm"),
        (2.0, 4.0, 0.1, "[2.0"),
        (-2.0, 0.9, 0.1, "+X, +Y, +Z"),
        (-1.0, 2.0, 0.1, "-X, -Y, -Z"),
    ],
)
def test_a_body_must_be_in_its_lattice(low: float, high: float, step: float, key: str) -> None:
    with refused(key):
        surface_of(lambda p: np.linalg.norm(p, axis=1) - 1.0, [low] * 3, [high] * 3, step)


def turned(points_mm: F64, angle: float) -> F64:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(points_mm @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]).T)


@pytest.mark.slow
@pytest.mark.parametrize(("blades", "pitch"), [(3, 25.0), (5, -40.0)])
def test_a_propeller_has_its_blades_and_its_pitch(blades: int, pitch: float) -> None:
    step = 0.3
    made = body("propeller", blades=blades, pitch_mm=pitch, chord_mm=7.0, step_mm=step)
    points = made.vertices_mm
    radius = np.hypot(points[:, 1], points[:, 2])
    assert 2.0 * radius.max() == pytest.approx(30.0, abs=0.5 * step)
    tree = cKDTree(points)
    assert tree.query(turned(points, 2.0 * np.pi / blades))[0].max() < step
    assert tree.query(turned(points, np.pi / blades))[0].max() > 5.0 * step
    for at in (8.0, 12.0):
        angle = np.arctan2(points[:, 2], points[:, 1])
        # one section, unrolled
        ring = (np.abs(radius - at) < 0.4) & (np.abs(angle) < np.pi / blades)
        outline = np.column_stack([points[ring, 0], at * angle[ring]])
        _, lengths, axes = np.linalg.svd(outline - outline.mean(axis=0), full_matrices=False)
        assert lengths[0] > 4.0 * lengths[1]
        climb = 2.0 * np.pi * at * axes[0, 0] / axes[0, 1]
        assert climb == pytest.approx(pitch, rel=0.03)  # of its long axis, as of the helix
        assert np.ptp(outline @ axes[0]) == pytest.approx(7.0, abs=step)
        assert np.ptp(outline @ axes[1]) == pytest.approx(0.15 * 7.0, abs=step / 3.0)
        thick = np.abs(outline @ axes[1]) > 0.9 * np.abs(outline @ axes[1]).max()
        # sections are thickest at 0.3 of the chord, where +X comes from
        assert outline[thick, 0].mean() < -0.1 * np.ptp(outline[:, 0])


@pytest.mark.slow
def test_a_reef_is_the_seed_s_stands_and_hides_itself() -> None:
    one, again, other = (body("reef", seed, step_mm=0.6) for seed in (1, 1, 2))
    assert_array_equal(one.vertices_mm, again.vertices_mm)
    assert one.vertices_mm.shape != other.vertices_mm.shape
    for made in (one, other):
        low, high = made.vertices_mm.min(axis=0), made.vertices_mm.max(axis=0)
        assert (low >= [-18.0, -20.0, -14.0]).all()
        assert (high <= [18.0, 1e-6, 14.0]).all()
        assert (high - low > 0.6 * np.array([36.0, 20.0, 28.0])).all()
        a, b, c = np.moveaxis(made.vertices_mm[made.faces], 1, 0)
        normals = np.cross(b - a, c - a) / 2.0
        ground = np.abs(made.vertices_mm[made.faces][:, :, 1]).max(axis=1) < 1e-6
        assert normals[ground, 1].sum() > 40.0
        overhangs = normals[~ground & (normals[:, 1] > 0.0), 1].sum()
        assert overhangs > normals[ground, 1].sum()  # from below, more of it is seen than its base
        assert characteristic(made) <= 0  # at least one hole goes through


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("hydrofoil", "digits", "012"),
        ("hydrofoil", "digits", "0000"),
        ("hydrofoil", "digits", "2012"),
        ("hydrofoil", "points", 9),
        ("propeller", "hub_mm", 40.0),
        ("propeller", "pitch_mm", 0.0),
        ("propeller", "step_mm", 0.7),
        ("propeller", "blades", 12),
        ("reef", "size_mm", [10.0, 0.0, 10.0]),
        ("reef", "step_mm", 0.01),
    ],
)
def test_impossible_bodies_are_named(name: str, key: str, value: Any) -> None:
    with refused(f"{key}: "):
        body(name, **{key: value})
