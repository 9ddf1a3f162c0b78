"""Surfaces for refocusing: limits, laws of geometry, and files of heights."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose

from sabench.geometry.surfaces import Cylinder, HeightMap, Plane, bend, normals_of
from tests.helpers.refusals import refused

POSE: dict[str, Any] = {"center_mm": (3.0, -2.0, 50.0), "turn_deg": (10.0, 25.0, -5.0)}


def test_pixels_of_a_plane_are_a_square_grid_about_its_centre() -> None:
    made = Plane(**POSE, size_mm=(7.0, 4.0), pixel_mm=0.5)
    points = made.points_mm()
    assert points.shape == (9, 15, 3)
    assert_allclose(points.mean(axis=(0, 1)), POSE["center_mm"], atol=1e-12)
    for axis in (0, 1):
        assert_allclose(np.linalg.norm(np.diff(points, axis=axis), axis=-1), 0.5, atol=1e-12)
    expected = np.broadcast_to(made.pose.rotation[:, 2], points.shape)
    assert_allclose(normals_of(points), expected, atol=1e-12)


@pytest.mark.parametrize("radius", [12.0, -12.0])
def test_points_of_a_cylinder_keep_their_distance_from_its_axis(radius: float) -> None:
    made = Cylinder(**POSE, size_mm=(30.0, 8.0), pixel_mm=0.05, radius_mm=radius)
    points = made.points_mm()
    axis = made.pose.rotation[:, 1]
    off = points - made.pose(np.array([[0.0, 0.0, radius]]))[0]
    across = off - (off @ axis)[..., None] * axis
    assert_allclose(np.linalg.norm(across, axis=-1), abs(radius), rtol=1e-12)
    chord = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    assert_allclose(24.0 * np.arcsin(chord / 24.0), 0.05, rtol=1e-9)  # the arc
    outward = np.einsum("ijk,ijk->ij", normals_of(points), across) / radius
    assert (outward[:, 1:-1] < -0.999).all()  # own +Z: to the axis, or away from it


def test_a_cylinder_of_infinite_radius_is_the_plane() -> None:
    """The sagitta x^2 / 2r falls as the radius grows, down to the last digit."""
    flat = Plane(**POSE, size_mm=(30.0, 8.0), pixel_mm=0.5).points_mm()
    for radius in (1e4, 1e8, 1e14, -1e14):
        bent = Cylinder(**POSE, size_mm=(30.0, 8.0), pixel_mm=0.5, radius_mm=radius).points_mm()
        assert np.abs(bent - flat).max() <= 15.0**2 / 2.0 / abs(radius) * 1.001 + 1e-13


def test_bending_keeps_the_thickness() -> None:
    plate = np.array([[4.0, 1.0, 0.0], [4.0, 1.0, 0.3]])
    low, high = bend(plate, 9.0)
    assert np.linalg.norm(high - low) == pytest.approx(0.3)
    assert np.linalg.norm(high - np.array([0.0, 1.0, 9.0])) == pytest.approx(9.0 - 0.3)
    with refused("radius_mm", "1.273", "8"):
        bend(plate, 0.0)


def test_height_maps_of_points_and_of_pixels_agree(tmp_path: Path) -> None:
    """A tilted plane is exact in both; between the points heights are linear."""
    x, y = np.meshgrid(np.arange(-6.0, 6.5, 1.0), np.arange(-4.0, 4.5, 1.0))
    z = 0.3 * x - 0.2 * y + 1.0
    table, image = tmp_path / "wall.csv", tmp_path / "wall.tif"
    rows = "\n".join(f"{a},{b},{c}" for a, b, c in zip(x.flat, y.flat, z.flat, strict=True))
    table.write_text(f"x_mm,y_mm,z_mm\n{rows}\n")
    tifffile.imwrite(image, z.astype(np.float32))
    by_points = HeightMap(**POSE, file=table, pixel_mm=0.3)
    by_pixels = HeightMap(**POSE, file=image, spacing_mm=1.0, pixel_mm=0.3)
    u, v = by_points.axes_mm
    assert (len(u), len(v)) == (41, 27)
    own = np.stack(np.meshgrid(u, v), axis=-1)
    expected = np.dstack([own, 0.3 * own[..., 0] - 0.2 * own[..., 1] + 1.0])
    assert_allclose(by_points.points_mm(), by_points.pose(expected), atol=1e-9)
    assert_allclose(by_pixels.points_mm(), by_pixels.pose(expected), atol=1e-5)
