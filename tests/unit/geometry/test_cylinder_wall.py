"""Light paths through cylinders, against rays that another program follows."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sabench.evaluation.gates.independent_projection import aim_at, shoot
from sabench.geometry import cylinder_kernels, refraction
from sabench.geometry.camera import aim, aimed_rotation
from sabench.geometry.cylinder_wall import CylinderWall
from sabench.geometry.lens import Distortion
from sabench.scenes.build import build_wall
from sabench.scenes.wall import CylinderSpec, LayerSpec
from sabench.utils.arrays import F64, triple
from tests.helpers.cameras import make_camera

GLASS = LayerSpec(index=1.52, thickness_mm=5.0)


def cylinder(outer_radius_mm: float, *layers: LayerSpec, **more: Any) -> CylinderSpec:
    own: dict[str, Any] = {"shape": "cylinder", "fluid_index": 1.333, "layers": layers}
    return CylinderSpec(outer_radius_mm=outer_radius_mm, **(own | more))


ASIDE: dict[str, Any] = {"axis_point_mm": (3.0, -2.0, 5.0), "axis": (0.3, 1.0, -0.2)}
THIN = LayerSpec(index=1.49, thickness_mm=2.0)
SPECS = {
    "glass": cylinder(40.0, GLASS),
    "bare": cylinder(40.0),
    "tilted": cylinder(55.0, GLASS, THIN, fluid_index=1.36, **ASIDE),
    "air gap": cylinder(60.0, GLASS, LayerSpec(index=1.0, thickness_mm=4.0), GLASS),
    "denser outside": cylinder(40.0, GLASS, air_index=1.333, fluid_index=1.0),
}
PINHOLE = np.array([60.0, -150.0, -480.0])


def points_in(spec: CylinderSpec, share: float, count: int, seed: int) -> F64:
    """Return points up to a share of the inner radius from the axis."""
    rng = np.random.default_rng(seed)
    radius = share * spec.inner_radius_mm * np.sqrt(rng.random(count))
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    frame = np.asarray(aimed_rotation(np.asarray(spec.axis)))
    local = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-60.0, 60.0, count)]
    )
    return np.asarray(np.asarray(spec.axis_point_mm) + local @ frame)


def misses(at: F64, along: F64, points: F64) -> F64:
    """Distances (n,) of points from rays."""
    return np.asarray(np.linalg.norm(np.cross(points - at, along), axis=1))


@pytest.mark.parametrize("kind", SPECS)
def test_paths_and_rays_are_those_of_a_vector_tracer(kind: str) -> None:
    """Rays that leave along a found path meet its point, and both programs agree on them."""
    spec = SPECS[kind]
    wall, points = build_wall(spec), points_in(spec, 0.6, 300, 1)
    paths = refraction.trace_to_points(wall, PINHOLE, points)
    assert paths.valid.all()
    at, along = shoot(spec, PINHOLE, paths.leaving)
    assert misses(at, along, points).max() < 1e-9
    rays = refraction.trace_into_fluid(wall, PINHOLE, paths.leaving)
    assert rays.valid.all()
    assert misses(rays.origins_mm, rays.directions, points).max() < 1e-9
    assert_allclose(rays.origins_mm, at, rtol=0, atol=1e-10)
    assert_allclose(rays.directions, along, rtol=0, atol=1e-12)
    assert_allclose(paths.arriving, along, rtol=0, atol=1e-12)
    assert_allclose(paths.leaving, aim_at(spec, PINHOLE, points), rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", SPECS)
def test_a_camera_projects_and_back_projects(kind: str) -> None:
    spec = SPECS[kind]
    lens = {"principal_distance_mm": 100.0, "distortion": Distortion(k1=-0.2, p1=1e-3)}
    size = {"rows": 800, "columns": 1000, "principal_point_px": (500.0, 400.0)}
    plain = make_camera(center_mm=triple(PINHOLE), wall=build_wall(spec), **lens, **size)
    camera, points = aim(plain, (0.0, 0.0, 0.0)), points_in(spec, 0.3, 200, 2)
    pixels, valid = camera.project(points)
    rays = camera.back_project(pixels)
    assert valid.all()
    assert rays.valid.all()
    assert misses(rays.origins_mm, rays.directions, points).max() < 1e-9
    there = camera.carry(points, 1.0)
    again = camera.project(np.column_stack([there, np.ones(len(there))]))[0]
    near = np.isfinite(again).all(axis=1)
    assert near.sum() > 100
    assert_allclose(again[near], pixels[near], rtol=0, atol=1e-8)


def _near(wall: CylinderWall, leaving: F64, points: F64) -> F64:
    """Return where rays come nearest to their points."""
    rays = wall.rays(PINHOLE, leaving)
    along = np.sum((points - rays.origins_mm) * rays.directions, axis=1, keepdims=True)
    return np.asarray(rays.origins_mm + along * rays.directions)


def forward(spec: CylinderSpec, count: int) -> tuple[F64, F64, F64]:
    """Rays' directions, a point on each, and the area of a bundle, positive before it crosses."""
    rng = np.random.default_rng(3)
    wall = build_wall(spec)
    inwards, axis = wall.normal_at(PINHOLE), np.asarray(wall.axis)
    across = np.cross(axis, inwards)
    aims = np.asarray(spec.axis_point_mm) + rng.uniform(-1.0, 1.0, (count, 2)) @ np.stack(
        [spec.outer_radius_mm * across, 200.0 * axis]
    )
    leaving = (aims - PINHOLE) / np.linalg.norm(aims - PINHOLE, axis=1, keepdims=True)
    rays = wall.rays(PINHOLE, leaving)
    leaving, start, along = (p[rays.valid] for p in (leaving, rays.origins_mm, rays.directions))
    radial, flat = (p - (p @ axis)[:, None] * axis for p in (start - wall.axis_point_mm, along))
    chord = -2.0 * np.sum(radial * flat, axis=1) / np.sum(flat**2, axis=1)
    points = start + (rng.uniform(0.01, 0.99, len(chord)) * chord)[:, None] * along
    first = np.cross(leaving, axis)
    one, other = (
        _near(wall, leaving + 1e-6 * side, points) - _near(wall, leaving - 1e-6 * side, points)
        for side in (first, np.cross(leaving, first))
    )
    return leaving, points, np.asarray(np.sum(np.cross(one, other) * along, axis=1))


@pytest.mark.parametrize("kind", SPECS)
def test_every_path_before_a_caustic_is_found(kind: str) -> None:
    """Also those next to the limb; behind a caustic the path found is the other one."""
    spec = SPECS[kind]
    leaving, points, area = forward(spec, 4000)
    paths = build_wall(spec).paths(PINHOLE, points)
    before = area > 0.0
    assert before.mean() > 0.9
    assert paths.valid[before].all()
    assert_allclose(paths.leaving[before], leaving[before], rtol=0, atol=1e-9)
    assert not (np.linalg.norm(paths.leaving[~before] - leaving[~before], axis=1) < 1e-6).any()


def test_points_without_a_path_are_not_valid() -> None:
    """In the wall, outside, in the shadow behind the limb, or without coordinates."""
    wall = build_wall(SPECS["glass"])
    points = [[0.0, 0.0, 0.0], [0.0, 0.0, -36.0], [0.0, 0.0, -45.0], [32.4, 0.0, 11.8]]
    points += [[math.nan, 0.0, 0.0], [0.0, math.inf, 0.0]]
    paths = refraction.trace_to_points(wall, np.array([0.0, 0.0, -500.0]), np.array(points))
    assert paths.valid.tolist() == [True, False, False, False, False, False]
    assert np.isnan(paths.leaving[1:]).all()
    assert np.isnan(paths.arriving[1:]).all()
    inside = refraction.trace_to_points(wall, np.array([0.0, 0.0, -37.0]), np.zeros((1, 3)))
    assert not inside.valid.any()


def test_rays_that_miss_the_fluid_are_not_valid() -> None:
    wall, pinhole = build_wall(SPECS["air gap"]), np.array([0.0, 0.0, -500.0])
    sideways = np.array([0.0, 0.05, 0.11, 0.13])  # of the last the line passes the cylinder
    directions = np.column_stack([sideways, np.zeros(4), np.sqrt(1.0 - sideways**2)])
    rays = refraction.trace_into_fluid(wall, pinhole, directions)
    assert rays.valid.tolist() == [True, True, False, False]
    assert np.isnan(rays.directions[2:]).all()
    assert refraction.transmittance(wall, pinhole, directions)[2:].tolist() == [0.0, 0.0]
    assert np.isnan(refraction.length_to_fluid(wall, pinhole, directions)[2:]).all()


def plane_twin(wall: CylinderWall, pinhole: F64) -> refraction.Wall:
    """The plane wall that touches a cylinder next to a pinhole."""
    normal = wall.normal_at(pinhole)
    foot = triple(pinhole - float(wall.depth_of(pinhole)) * normal)
    return refraction.Wall(foot, triple(normal), wall.air_index, wall.layers, wall.fluid_index)


@pytest.mark.parametrize("kind", ["glass", "tilted"])
def test_without_curvature_the_kernels_are_a_plane_wall(kind: str) -> None:
    """To rounding: the curvature is zero in place of small."""
    wall = build_wall(SPECS[kind])
    flat, pinhole = plane_twin(wall, PINHOLE), PINHOLE
    gap, frame = -float(wall.depth_of(pinhole)), wall._frame(pinhole)
    faces = np.column_stack([np.zeros(len(wall.layers) + 1), flat.interface_depths_mm])
    local = np.random.default_rng(4).uniform([8.0, -60.0, -60.0], [90.0, 60.0, 60.0], (200, 3))
    leaving, arriving = np.zeros_like(local), np.zeros_like(local)
    assert cylinder_kernels.find_light_paths(
        gap, faces, wall.indices, local, leaving, arriving
    ).all()
    points = pinhole + (local + np.array([gap, 0.0, 0.0])) @ frame
    paths = refraction.trace_to_points(flat, pinhole, points)
    assert_allclose(leaving @ frame, paths.leaving, rtol=0, atol=1e-15 * 5)
    assert_allclose(arriving @ frame, paths.arriving, rtol=0, atol=1e-15 * 5)
    ends, length, passed = np.zeros_like(local), np.zeros(200), np.zeros(200)
    there = leaving.copy()
    assert cylinder_kernels.follow(gap, faces, wall.indices, there, ends, length, passed).all()
    assert_allclose(there, arriving, rtol=0, atol=1e-15 * 5)
    assert_allclose(
        length, refraction.length_to_fluid(flat, pinhole, paths.leaving), rtol=1e-14, atol=0
    )
    assert_allclose(
        passed, refraction.transmittance(flat, pinhole, paths.leaving), rtol=1e-14, atol=0
    )


@pytest.mark.parametrize("kind", SPECS)
def test_rays_in_a_plane_through_the_axis_see_a_plane_wall(kind: str) -> None:
    spec = SPECS[kind]
    wall = build_wall(spec)
    normal, axis = wall.normal_at(PINHOLE), np.asarray(wall.axis)
    rng = np.random.default_rng(6)
    depth = rng.uniform(-0.9, 0.9, 100) * spec.inner_radius_mm
    foot = PINHOLE - np.dot(PINHOLE - wall.axis_point_mm, normal) * normal
    points = foot + depth[:, None] * normal + rng.uniform(-80.0, 80.0, 100)[:, None] * axis
    flat = plane_twin(wall, PINHOLE)
    round_, plane = (refraction.trace_to_points(one, PINHOLE, points) for one in (wall, flat))
    assert_allclose(round_.leaving, plane.leaving, rtol=0, atol=2e-14)
    assert_allclose(round_.arriving, plane.arriving, rtol=0, atol=2e-14)
    lengths, passed = (
        [function(one, PINHOLE, plane.leaving) for one in (wall, flat)]
        for function in (refraction.length_to_fluid, refraction.transmittance)
    )
    assert_allclose(lengths[0], lengths[1], rtol=1e-12)
    assert_allclose(passed[0], passed[1], rtol=1e-12)
