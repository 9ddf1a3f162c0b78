"""Flow around bodies: drag, rest at the surface, divergence, and the wake's side."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from sabench.api import Solid
from sabench.api.make import generator_of
from sabench.utils.arrays import F64
from sabench.worlds.library.overlaps import contains
from sabench.worlds.library.slow_flow import PeriodicBox, SlowFlow, solve_oseen
from tests.helpers.refusals import refused

_EDGE_MM, _RADIUS_MM = 20.0, 3.0
_SLOW = 1e6  # mm2/s: the Reynolds number is 6e-6


def ball(radius_mm: float = _RADIUS_MM) -> Solid:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    return Solid(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def flow(count: int = 32, viscosity: float = _SLOW) -> SlowFlow:
    box = PeriodicBox(np.full(3, -_EDGE_MM / 2.0), _EDGE_MM / count, (count, count, count))
    return solve_oseen([ball()], box, np.array([1.0, 0.0, 0.0]), viscosity)


def directions(count: int = 2000) -> F64:
    drawn = np.random.default_rng(0).normal(size=(count, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


@pytest.mark.slow
def test_drag_is_that_of_hasimoto_and_converges() -> None:
    """F = 6 pi mu a U / (1 - 1.7601 c^(1/3) + c - 1.5593 c^2), Hasimoto (1959)."""
    part = 4.0 / 3.0 * np.pi * _RADIUS_MM**3 / _EDGE_MM**3
    exact = 6.0 * np.pi * _SLOW * _RADIUS_MM
    exact /= 1.0 - 1.7601 * part ** (1.0 / 3.0) + part - 1.5593 * part**2
    coarse, fine = (flow(count).force / exact for count in (24, 40))
    assert abs(fine[0] - 1.0) < 0.06
    assert abs(fine[0] - 1.0) < abs(coarse[0] - 1.0)
    assert_allclose(fine[1:], 0.0, atol=2e-3)


@pytest.mark.slow
def test_fluid_rests_at_the_surface_and_hardly_passes_it() -> None:
    made, normal = flow(), directions()
    assert np.sqrt((np.sum(made.velocity(_RADIUS_MM * normal) * normal, axis=1) ** 2).mean()) < 0.02
    assert np.sqrt((made.velocity(0.8 * _RADIUS_MM * normal) ** 2).sum(axis=1).mean()) < 0.02


@pytest.mark.slow
def test_field_is_free_of_divergence_and_gradient_is_that_of_differences() -> None:
    made, points, step = flow(24), 8.0 * directions(300), 1e-5
    gradient = made.gradient(points)
    assert np.abs(np.einsum("nii->n", gradient)).max() < 1e-12
    differences = [
        (made.velocity(points + step * axis) - made.velocity(points - step * axis)) / (2.0 * step)
        for axis in np.eye(3)
    ]
    assert_allclose(gradient, np.stack(differences, axis=-1), atol=1e-7)


@pytest.mark.slow
def test_convection_leaves_a_wake_downstream() -> None:
    behind, before = (
        flow(24, viscosity=0.2).velocity(np.array([[x, 0.0, 0.0]]))[0, 0] for x in (6.0, -6.0)
    )
    slow = flow(24)
    same = [slow.velocity(np.array([[x, 0.0, 0.0]]))[0, 0] for x in (6.0, -6.0)]
    assert abs(same[0] - same[1]) < 0.02
    assert before - behind > 5.0 * abs(same[0] - same[1])
    assert before - behind > 0.1  # of the mean flow


def test_points_in_a_ball_are_those_within_its_radius() -> None:
    points = np.random.default_rng(1).uniform(-4.0, 4.0, (5000, 3))
    radius = np.linalg.norm(points, axis=1)
    clear = np.abs(radius - _RADIUS_MM) > 0.03  # of the facets
    assert_array_equal(contains(ball(), points)[clear], (radius < _RADIUS_MM)[clear])


def test_a_point_on_a_face_belongs_to_one_of_two_bodies_that_share_it() -> None:
    points = np.mgrid[0:9, 0:9, 0:9].reshape(3, -1).T / 4.0
    for axis in range(3):
        cube = trimesh.creation.box(bounds=[[0.0] * 3, [1.0] * 3])
        beside = cube.vertices + np.eye(3)[axis]
        both = [contains(Solid(np.array(v), cube.faces), points) for v in (cube.vertices, beside)]
        assert [inside.sum() for inside in both] == [64, 64]
        assert not (both[0] & both[1]).any()


def test_a_body_smaller_than_a_step_is_refused() -> None:
    box = PeriodicBox(np.full(3, -10.0), 2.5, (8, 8, 8))
    tiny = Solid(ball(0.5).vertices_mm + 1.2, ball(0.5).faces)
    with refused():
        solve_oseen([tiny], box, np.array([1.0, 0.0, 0.0]), 1.0)


def test_flow_around_refuses_a_box_that_does_not_hold_the_body() -> None:
    from sabench.api import Domain

    made = generator_of({"generator": "flow_around", "box_mm": [5.0, 9.0, 9.0]})
    domain = Domain((0.0, 0.0, 0.0), (8.0, 8.0, 8.0), 100)
    with refused("box_mm"):
        made.surround([ball()], domain)
