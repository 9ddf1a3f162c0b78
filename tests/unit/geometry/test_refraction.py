"""The light path through a wall, against paths that are built by hand."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import sabench.geometry.refraction
from sabench.geometry.camera import Camera, aimed_rotation
from sabench.geometry.refraction import (
    Layer,
    Wall,
    _halley,
    _lateral,
    _lateral_distance,
    _start,
    solve_slope,
    trace_into_fluid,
    trace_to_points,
    transmittance,
)
from sabench.utils.arrays import F64, triple
from tests.helpers.cameras import make_camera

UP = np.array([0.0, 0.0, 1.0])
ANYWHERE = np.zeros(3)  # pinhole: a plane wall transmits the same from everywhere


def unit(vector: Any) -> F64:
    array = np.asarray(vector, dtype=np.float64)
    return np.asarray(array / np.linalg.norm(array))


def make_wall(
    indices: list[float], thicknesses: list[float], normal: Any = UP, point: Any = ANYWHERE
) -> Wall:
    pairs = zip(indices[1:-1], thicknesses, strict=True)
    layers = tuple(Layer("layer", index, thickness) for index, thickness in pairs)
    return Wall(triple(np.asarray(point)), triple(unit(normal)), indices[0], layers, indices[-1])


def random_walls() -> list[Wall]:
    """Tilted walls of 0 to 4 layers, 0.01 to 50 mm thick, some rarer than both sides."""
    rng = np.random.default_rng(20)
    walls = []
    for k in range(20):
        indices = rng.uniform(1.0, 2.4, 2 + k % 5)
        if k % 5 == 3:
            indices[[0, 2, -1]] = 1.5, 1.0, 1.7  # an air gap in glass
        thicknesses = 10.0 ** rng.uniform(-2.0, math.log10(50.0), k % 5)
        place = [*rng.uniform(-0.5, 0.5, 2), 1.0], rng.uniform(-40.0, 40.0, 3)
        walls.append(make_wall(indices.tolist(), thicknesses.tolist(), *place))
    return walls


WALLS = random_walls()


def hand_path(wall: Wall, before: float, behind: float, sine: float) -> tuple[F64, F64]:
    """Lateral positions and depths of a path's corners; `sine` is that in the rarest medium."""
    depths = np.array([before, *(layer.thickness_mm for layer in wall.layers), behind])
    lateral = depths * np.tan(np.arcsin(min(wall.indices) * sine / wall.indices))
    return np.cumsum([0.0, *lateral]), np.cumsum([-before, *depths])


def hand_paths(wall: Wall, count: int, seed: int) -> list[F64]:
    """Corners (2 + interfaces, 3) of paths from one pinhole, up to 78 degrees in any medium."""
    rng = np.random.default_rng(seed)
    first, second, normal = np.asarray(aimed_rotation(np.asarray(wall.normal)))
    before = rng.uniform(100.0, 600.0)
    paths = []
    for _ in range(count):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        across = math.cos(turn) * first + math.sin(turn) * second
        ends = rng.uniform(0.1, 200.0), rng.uniform(0.0, 0.98)
        lateral, depth = hand_path(wall, before, *ends)
        paths.append(wall.point_mm + np.outer(lateral, across) + np.outer(depth, normal))
    return paths


def sine_of(segment: F64, normal: Any) -> float:
    return float(np.linalg.norm(np.cross(unit(segment), normal)))


def straight_camera(wall: Wall | None, **changes: Any) -> Camera:
    return make_camera(principal_distance_mm=60.0, focal_length_mm=50.0, wall=wall, **changes)


@pytest.mark.parametrize("wall", WALLS)
def test_finds_the_path_that_was_built_by_hand(wall: Wall) -> None:
    paths = hand_paths(wall, 30, 1)
    found = trace_to_points(wall, paths[0][0], np.stack([path[-1] for path in paths]))
    assert found.valid.all()
    assert_allclose(found.leaving, [unit(path[1] - path[0]) for path in paths], rtol=0, atol=1e-11)
    expected = [unit(path[-1] - path[-2]) for path in paths]
    assert_allclose(found.arriving, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("wall", WALLS)
def test_fermat_no_neighbouring_path_is_shorter(wall: Wall) -> None:
    depths = [350.0, *(layer.thickness_mm for layer in wall.layers), 80.0]
    rng, count = np.random.default_rng(1), len(depths) - 1
    for reach in (5.0, 120.0):
        slope = solve_slope(wall.indices, [*depths], np.array([reach]))[0]
        corners = hand_path(wall, 350.0, 80.0, slope / math.hypot(1.0, slope))[0]
        moves = np.zeros((200, count + 2))
        moves[1:, 1:-1] = 10.0 ** rng.uniform(-3.0, 1.0, (199, 1)) * rng.normal(size=(199, count))
        assert corners[-1] == pytest.approx(reach)
        lengths = np.hypot(np.diff(corners + moves, axis=1), depths) @ wall.indices
        assert lengths.argmin() == 0


@pytest.mark.parametrize("wall", WALLS)
def test_the_iteration_ends_in_a_few_steps(wall: Wall, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stopping rule asks for no more digits than a double has."""
    calls, lateral = [], sabench.geometry.refraction._lateral

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        return lateral(*arguments)

    monkeypatch.setattr(sabench.geometry.refraction, "_lateral", counted)
    thicknesses = [layer.thickness_mm for layer in wall.layers]
    solve_slope(wall.indices, [400.0, *thicknesses, 60.0], np.linspace(0.0, 2000.0, 4001))
    assert len(calls) <= 20


@pytest.mark.slow_but_first
@pytest.mark.parametrize("wall", WALLS)
def test_back_projection_returns_to_the_point(wall: Wall) -> None:
    paths = hand_paths(wall, 60, 5)
    points = np.stack([path[-1] for path in paths])
    axes = aimed_rotation(np.asarray(wall.normal))
    camera = straight_camera(wall, center_mm=triple(paths[0][0]), rotation=axes)
    pixels, valid = camera.project(points)
    rays = camera.back_project(pixels)
    assert valid.all()
    assert rays.valid.all()
    assert np.linalg.norm(np.cross(points - rays.origins_mm, rays.directions), axis=1).max() < 1e-9
    assert_allclose(wall.depth_of(rays.origins_mm), wall.thickness_mm, rtol=0, atol=1e-9)
    assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0, rtol=0, atol=1e-14)


@pytest.mark.parametrize("behind", [1e-3, 0.1, 10.0])
def test_grazing_points_end_near_the_critical_angle(behind: float) -> None:
    wall = make_wall([1.0, 1.5, 1.333], [5.0])
    pinhole, point = np.array([0.0, 0.0, -300.0]), np.array([1e4, 0.0, 5.0 + behind])
    sine = sine_of(trace_to_points(wall, pinhole, point[None]).leaving[0], wall.normal)
    assert 0.999 < sine < 1.0
    assert hand_path(wall, 300.0, behind, sine)[0][-1] == pytest.approx(1e4, rel=1e-6)


@pytest.mark.parametrize("indices", [[1.5, 1.0], [1.5, 1.0, 1.6], [1.5, 1.7, 1.0, 1.6]])
def test_total_reflection_is_not_valid(indices: list[float]) -> None:
    wall = make_wall(indices, [3.0] * (len(indices) - 2), normal=(0.1, 0.2, 1.0))
    across = np.asarray(aimed_rotation(np.asarray(wall.normal)))[0]
    sines = (1.0 / 1.5) * np.array([0.5, 1.0 - 1e-9, 1.0 + 1e-9, 1.2, 1.49])
    directions = (
        np.sqrt(1.0 - sines**2)[:, None] * np.asarray(wall.normal) + sines[:, None] * across
    )
    rays = trace_into_fluid(wall, np.array([0.0, 0.0, -100.0]), directions)
    assert rays.valid.tolist() == [True, True, False, False, False]
    assert np.isnan(rays.directions[2:]).all()
    assert transmittance(wall, ANYWHERE, directions)[2:].tolist() == [0.0, 0.0, 0.0]


def test_points_without_a_path_are_not_valid() -> None:
    camera, good = straight_camera(make_wall([1.0, 1.5, 1.333], [5.0])), (4.0, -3.0, 30.0)
    bad = [(0.0, 0.0, -50.0), (3.0, 1.0, 0.0), (0.0, 5.0, 2.0), (1.0, 0.0, 5.0)]
    pixels, valid = camera.project([good, *bad, (math.nan, 0.0, 30.0), (0.0, math.inf, 30.0), good])
    assert valid.tolist() == [True, *[False] * 6, True]
    assert np.isnan(pixels[~valid]).all()
    assert_array_equal(pixels[valid], camera.project([good, good])[0])


@pytest.mark.parametrize("depth", [0.0, 0.5, 2.0, 5.0, 80.0])
def test_a_pinhole_behind_the_face_sees_nothing(depth: float) -> None:
    wall = make_wall([1.0, 1.5, 1.333], [5.0])
    pinhole = np.array([1.0, 2.0, depth])
    camera = straight_camera(wall, center_mm=triple(pinhole))
    assert not camera.project([[0.0, 0.0, 100.0], [3.0, -4.0, 9.0]])[1].any()
    assert not trace_to_points(wall, pinhole, np.array([[0.0, 0.0, 100.0]])).valid.any()
    assert not trace_into_fluid(wall, pinhole, np.array([[0.0, 0.0, 1.0]])).valid.any()


def test_rays_that_leave_the_wall_are_not_valid() -> None:
    wall = make_wall([1.0, 1.5, 1.333], [5.0])
    directions = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8], [math.nan, 0.0, 1.0]]
    rays = trace_into_fluid(wall, np.array([0.0, 0.0, -100.0]), np.array(directions))
    assert rays.valid.tolist() == [True, False, False, False]


@pytest.mark.parametrize("wall", WALLS)
def test_transmittance_is_the_transmitted_power(wall: Wall) -> None:
    """n2 cos2 |t|^2 / (n1 cos1) of each interface, the mean over both polarisations."""
    n1, n2 = wall.indices[:-1], wall.indices[1:]
    for path in hand_paths(wall, 10, 7):
        sines = np.array([sine_of(step, wall.normal) for step in np.diff(path, axis=0)])
        c1, c2 = np.sqrt(1.0 - sines[:-1] ** 2), np.sqrt(1.0 - sines[1:] ** 2)
        across, along = 2.0 * n1 * c1 / (n1 * c1 + n2 * c2), 2.0 * n1 * c1 / (n2 * c1 + n1 * c2)
        expected = np.prod(n2 * c2 / (n1 * c1) * (across**2 + along**2) / 2.0)
        found = transmittance(wall, path[0], unit(path[1] - path[0])[None])[0]
        assert found == pytest.approx(expected, rel=1e-10)


def test_order_and_splitting_of_layers_do_not_matter() -> None:
    points = np.random.default_rng(10).uniform([-80.0, -50.0, 40.0], [80.0, 50.0, 90.0], (40, 3))
    stacks = [
        (([1.5, 1.2], [5.0, 2.0]), ([1.2, 1.5], [2.0, 5.0])),
        (([1.5], [5.0]), ([1.5, 1.5], [1.0, 4.0])),
    ]
    for pair in stacks:
        one, other = (
            straight_camera(make_wall([1.0, *n, 1.333], d)).project(points)[0] for n, d in pair
        )
        assert_allclose(other, one, rtol=0, atol=1e-9)


def test_scaling_all_lengths_or_all_indices_changes_no_direction() -> None:
    points = np.random.default_rng(11).uniform([-80.0, -50.0, 40.0], [80.0, 50.0, 90.0], (40, 3))
    pinhole = np.array([5.0, 9.0, -300.0])
    plain = trace_to_points(make_wall([1.0, 1.5, 1.333], [5.0]), pinhole, points)
    larger = trace_to_points(make_wall([1.0, 1.5, 1.333], [35.0]), 7.0 * pinhole, 7.0 * points)
    for other in (larger, trace_to_points(make_wall([1.3, 1.95, 1.7329], [5.0]), pinhole, points)):
        assert_allclose(other.leaving, plain.leaving, rtol=0, atol=1e-14)
        assert_allclose(other.arriving, plain.arriving, rtol=0, atol=1e-14)


PATHS: list[tuple[F64, list[F64 | float]]] = [
    (np.array([1.0, 1.5, 1.333]), [300.0, 6.0, 40.0]),
    (np.array([1.0, 1.5, 1.46, 1.333]), [20.0, 10.0, 30.0, 200.0]),
    (np.array([1.333, 1.0]), [5.0, 80.0]),
    (np.array([1.7, 1.2, 1.0]), [10.0, 40.0, 0.1]),
]


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS)
def test_derivatives_are_those_of_lateral(relative: F64, depths_mm: list[F64 | float]) -> None:
    """Central differences; the second derivative is stated over -3 t."""
    slope, step = np.array([0.05, 0.3, 0.8, 2.0]), 1e-4
    value, gradient, curvature = _lateral_distance(relative, depths_mm, slope)
    before, after = (_lateral(relative, depths_mm, slope + by) for by in (-step, step))
    assert_allclose(value, _lateral(relative, depths_mm, slope)[0], rtol=1e-13)
    assert_allclose(gradient, (after[0] - before[0]) / (2.0 * step), rtol=1e-6)
    assert_allclose(curvature, (after[1] - before[1]) / (2.0 * step) / (-3.0 * slope), rtol=1e-4)


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS)
def test_the_first_slope_is_of_fifth_order(relative: F64, depths_mm: list[F64 | float]) -> None:
    """Half the slope leaves a 32nd of the error. A path far longer than deep is in the rarest."""
    slope = np.array([2e-2, 1e-2, 1e5])
    start = _start(relative, depths_mm, _lateral(relative, depths_mm, slope)[0])
    error = start - slope
    assert error[0] / error[1] == pytest.approx(32.0, rel=0.1)
    assert start[2] == pytest.approx(1e5, rel=0.05)


@pytest.mark.parametrize(("relative", "depths_mm"), PATHS[:3])
def test_halley_converges_without_a_bracket(relative: F64, depths_mm: list[F64 | float]) -> None:
    """Steep and flat paths alike need few steps, unless the rarest layer is thin."""
    slope = np.geomspace(1e-3, 1e2, 60)
    found: Any = _halley(relative, depths_mm, _lateral(relative, depths_mm, slope)[0])
    assert_allclose(found, slope, rtol=1e-9)
