"""Light paths of many particles: polynomials over the volume against exact paths."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from sabench.geometry.camera import Camera
from sabench.scenes import Scene, build_rig, find, parse_scene
from sabench.simulation.rendering import light_paths
from sabench.simulation.rendering.light_paths import SMOOTH, Box, find_paths
from sabench.utils.arrays import F64, triple


def scene_of(name: str) -> Scene:
    """Read a bundled scene."""
    return parse_scene(tomllib.loads(find(name, "scenes").read_text(encoding="utf-8")), name)


def volume_of(scene: Scene) -> Box:
    """Return the corners of a scene's volume."""
    center, half = np.asarray(scene.volume.center_mm), np.asarray(scene.volume.size_mm) / 2.0
    return triple(center - half), triple(center + half)


def points_in(box: Box, count: int) -> F64:
    """Draw points (n, 3) in a box."""
    low, high = np.asarray(box)
    return np.asarray(low + (high - low) * np.random.default_rng(5).random((count, 3)))


@pytest.mark.parametrize(
    "name", ["quick", "standard-particles", "scheimpflug", "two-faces", "cylinder-tank"]
)
def test_polynomials_are_as_good_as_exact_paths(name: str) -> None:
    scene = scene_of(name)
    box = volume_of(scene)
    points = points_in(box, 3000)
    for camera in build_rig(scene, name).cameras[:3]:
        assert light_paths._interpolate(camera, box) is not None
        found, exact = find_paths(camera, points, box), find_paths(camera, points)
        np.testing.assert_allclose(found.pixel, exact.pixel, rtol=0, atol=1e-9)
        assert found.valid.all()
        assert exact.valid.all()
        for one in SMOOTH:
            truth = getattr(exact, one)
            error = np.abs(getattr(found, one) - truth).max()
            assert error <= 2e-7 * max(np.abs(truth).max(), 0.01), one


def camera_of(name: str) -> tuple[Camera, Box]:
    """Return a scene's first camera, and its volume."""
    scene = scene_of(name)
    return build_rig(scene, name).cameras[0], volume_of(scene)


def test_a_thin_volume_needs_fewer_terms() -> None:
    """Terms of high powers of its depth are left out."""
    camera, (low, high) = camera_of("quick")
    middle = (low[2] + high[2]) / 2.0
    thick = light_paths._interpolate(camera, (low, high))
    thin = (*low[:2], middle - 0.1), (*high[:2], middle + 0.1)
    flat = light_paths._interpolate(camera, thin)
    assert thick is not None
    assert flat is not None
    assert len(flat.terms) < 0.7 * len(thick.terms)
    assert flat.terms[:, 2].max() < thick.terms[:, 2].max()
    assert flat.coefficients.shape[1] == len(flat.terms)


def test_a_tiny_volume_needs_one_term() -> None:
    """All that is left is the value in its middle, and points get it."""
    camera, (low, high) = camera_of("quick")
    middle = (np.asarray(low) + np.asarray(high)) / 2.0
    tiny = triple(middle - 1e-7), triple(middle + 1e-7)
    smooth = light_paths._interpolate(camera, tiny)
    assert smooth is not None
    assert smooth.terms.tolist() == [[0, 0, 0]]
    found, exact = (find_paths(camera, np.tile(middle, (300, 1)), box) for box in (tiny, None))
    np.testing.assert_allclose(found.arriving, exact.arriving, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.solid_angle, exact.solid_angle, rtol=1e-7)


def test_points_outside_the_box_have_exact_paths() -> None:
    camera, (low, high) = camera_of("quick")
    points = points_in((low, high), 200)
    points[::7] += 1.01 * (np.asarray(high) - np.asarray(low))
    outside = np.arange(200) % 7 == 0
    found, exact = find_paths(camera, points, (low, high)), find_paths(camera, points)
    for one in SMOOTH:
        np.testing.assert_array_equal(getattr(found, one)[outside], getattr(exact, one)[outside])


def test_a_box_that_reaches_through_the_wall_has_no_polynomials() -> None:
    """Half of the points are in the wall or the air: no path leads there."""
    camera, (low, high) = camera_of("quick")
    box = (low[0], low[1], low[2] - 1000.0), high
    assert light_paths._interpolate(camera, box) is None
    points = points_in(box, 300)
    found, exact = find_paths(camera, points, box), find_paths(camera, points)
    assert 0 < exact.valid.sum() < 300
    np.testing.assert_array_equal(found.valid, exact.valid)
    np.testing.assert_array_equal(found.solid_angle, exact.solid_angle)


def test_a_volume_too_large_for_any_degree_has_exact_paths() -> None:
    """A camera 30 mm before a volume of 100 mm: what it gathers changes tenfold."""
    camera, (low, _) = camera_of("quick")
    near = replace(camera, wall=None, center_mm=(0.0, 0.0, low[2] - 30.0))
    box = (-50.0, -50.0, low[2]), (50.0, 50.0, low[2] + 100.0)
    assert light_paths._interpolate(near, box) is None
    points = points_in(box, 100)
    found, exact = find_paths(near, points, box), find_paths(near, points)
    np.testing.assert_array_equal(found.solid_angle, exact.solid_angle)
