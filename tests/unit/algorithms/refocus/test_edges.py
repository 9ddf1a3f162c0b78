"""Edges in refocused stacks of known depth."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from reproduction.edge_depth import count_views, edge_scores, find_rim, silhouette
from sabench.algorithms.refocus import find_edges, refocus_sum
from sabench.algorithms.refocus.edges import plane_gradient
from sabench.api.truth import Solid
from sabench.geometry.camera import Camera, aim
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32
from tests.helpers.cameras import ALONG_Z, make_camera

GRID = Grid((-8.0, -6.0, -10.0), (0.2, 0.2, 0.5), (41, 61, 81))
SLOPES = np.array([-0.18, 0.0, 0.18])  # of the views


def straight_edge(angle: float, depth: float, offset: float) -> F32:
    """Refocus views of a dark half plane whose edge is at one depth, analytically."""
    x, y, z = GRID.axes_mm
    across = np.array([np.cos(angle), np.sin(angle)])
    stack = np.zeros((len(z), len(y), len(x)))
    for slope_x in SLOPES:
        for slope_y in SLOPES:
            shift = (z - depth) * (np.array([slope_x, slope_y]) @ across)
            place = x * across[0] + y[:, None] * across[1] - offset - shift[:, None, None]
            stack += ndtr(place / 0.15) / 9.0
    return np.asarray(stack, dtype=np.float32)


@pytest.mark.parametrize(
    ("angle", "depth", "offset"), [(0.0, 0.13, 0.37), (0.6, -2.71, -1.02), (np.pi, 3.3, 0.5)]
)
def test_a_straight_edge_is_found_at_its_depth(angle: float, depth: float, offset: float) -> None:
    found = find_edges(straight_edge(angle, depth, offset), GRID, least=0.5, reach_mm=1.5)
    assert len(found) > 40
    inner = (np.abs(found.position_mm[:, :2]) < 4.0).all(axis=1)
    place, normal = found.position_mm[inner], found.normal[inner]
    across = np.array([np.cos(angle), np.sin(angle)])
    assert_allclose(place[:, 2], depth, atol=0.05)  # a tenth of a plane's spacing
    assert_allclose(place[:, :2] @ across, offset, atol=0.02)
    assert_allclose(normal, np.broadcast_to(across, normal.shape), atol=0.01)


def test_noise_moves_the_depth_little_and_without_bias() -> None:
    stack = straight_edge(0.3, 1.2, 0.0)
    noise = np.random.default_rng(1).normal(scale=0.02, size=stack.shape).astype(np.float32)
    errors = find_edges(stack + noise, GRID, least=0.5, reach_mm=1.5).position_mm[:, 2] - 1.2
    assert abs(np.median(errors)) < 0.05
    assert np.median(np.abs(errors)) < 0.15


def test_an_edge_beyond_the_faces_and_a_faint_one_are_none() -> None:
    assert len(find_edges(straight_edge(0.0, 14.0, 0.0), GRID, least=0.5, reach_mm=1.5)) == 0
    assert len(find_edges(0.3 * straight_edge(0.0, 0.0, 0.0), GRID, least=0.5, reach_mm=1.5)) == 0


def test_the_gradient_of_a_step_is_its_height() -> None:
    """An edge blurred by s voxels has the gradient of one of height h / sqrt(1 + s^2)."""
    for blur in (1.0, 2.0):
        row = 0.7 * ndtr((np.arange(31) - 15.0) / blur)
        along_x, along_y = plane_gradient(np.tile(row, (1, 31, 1)).astype(np.float32))
        assert along_x[0, 15, 15] == pytest.approx(0.7 / np.hypot(1.0, blur), rel=0.005)
        assert np.abs(along_y).max() < 1e-6


def cylinder(radius: float, depth: float) -> Solid:
    angles = np.linspace(0.0, 2.0 * np.pi, 96, endpoint=False)
    ring = np.column_stack([radius * np.cos(angles), np.zeros(96), depth + radius * np.sin(angles)])
    levels = np.linspace(-9.0, 9.0, 37)
    vertices = np.concatenate([ring + np.array([0.0, y, 0.0]) for y in levels])
    first = np.arange(96)
    after = (first + 1) % 96
    faces = []
    for low in 96 * np.arange(36):
        faces.append(np.column_stack([low + first, low + 96 + first, low + after]))
        faces.append(np.column_stack([low + after, low + 96 + first, low + 96 + after]))
    return Solid(vertices, np.concatenate(faces))


def array_of_nine() -> tuple[Camera, ...]:
    """Return cameras in air, 110 mm apart and 620 mm away."""
    values = {"rows": 300, "columns": 340, "principal_point_px": (169.5, 149.5)}
    values |= {"rotation": ALONG_Z, "principal_distance_mm": 54.0, "pixel_mm": 0.0099}
    centers = [(x, y, -620.0) for y in (-110.0, 0.0, 110.0) for x in (-110.0, 0.0, 110.0)]
    return tuple(aim(make_camera(center_mm=center, **values), np.zeros(3)) for center in centers)


def test_a_cylinder_has_its_edges_at_the_depth_of_its_axis() -> None:
    """The rim as seen from the middle of the array is at R^2/D before the axis."""
    cameras, solid = array_of_nine(), cylinder(1.6, 1.3)
    masks = [silhouette(camera, [solid]) for camera in cameras]
    views = [cv2.GaussianBlur(1.0 - mask.astype(np.float32), (0, 0), 0.7) for mask in masks]
    stack = refocus_sum(np.stack(views), cameras, GRID, outside=1.0) / 9.0
    found = find_edges(stack, GRID, least=0.5, reach_mm=1.5)
    rim = find_rim(solid, np.array([0.0, 0.0, -620.0]))
    assert_allclose(np.abs(rim.position_mm[:, 0]), 1.6, atol=0.01)
    assert_allclose(rim.position_mm[:, 2], 1.3 - 1.6**2 / 621.3, atol=0.02)
    assert_allclose(np.abs(rim.normal[:, 0]), 1.0, atol=0.01)
    visible = rim[count_views(rim, cameras, masks, 0.4) > 0.5]
    assert len(visible.position_mm) > 100
    inner = np.abs(visible.position_mm[:, 1]) < 5.0
    scores: Any = edge_scores(found.position_mm, visible.position_mm[inner])
    assert scores["located"] == 1.0
    assert scores["recall"] > 0.97
    assert scores["precision"] > 0.8
    assert scores["median_mm"] < 0.2
    assert scores["bias_mm"] == pytest.approx(0.0, abs=0.1)


def test_a_hidden_rim_is_not_visible() -> None:
    cameras = array_of_nine()
    front, back = cylinder(1.6, 1.3), cylinder(0.4, 6.0)
    masks = [silhouette(camera, [front, back]) for camera in cameras]
    rim = find_rim(back, np.array([0.0, 0.0, -620.0]))
    assert count_views(rim, cameras, masks, 0.3).max() < 0.4
    alone = [silhouette(camera, [back]) for camera in cameras]
    assert count_views(rim[np.abs(rim.position_mm[:, 1]) < 5.0], cameras, alone, 0.3).min() > 0.9


def test_scores_of_exact_shifted_and_missing_edges() -> None:
    truth = np.random.default_rng(1).uniform(-5.0, 5.0, (200, 3))
    exact = edge_scores(truth, truth)
    shares = dict.fromkeys(("located", "recall", "precision"), 1.0)
    assert exact == shares | {"median_mm": 0.0, "bias_mm": 0.0}
    far = edge_scores(truth + np.array([0.0, 0.0, 3.0]), truth)
    assert far["located"] == 1.0
    assert far["bias_mm"] == pytest.approx(3.0)
    assert far["recall"] == 0.0
    assert edge_scores(truth[:0], truth)["recall"] is None
