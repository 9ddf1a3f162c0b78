"""Circulation and cores of vortices whose circulation is known. And pictures of fields."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from reproduction.vortex_rings import circulation, core, half_plane, interpolate_field, spin_of
from sabench.api import Velocity
from sabench.api.make import generator_of
from sabench.metrics.velocity_error import response
from sabench.plotting.drawing import Figure, Panel, Picture, Slice, draw
from sabench.utils.arrays import F64, triple


def on_lattice(flow: Any, counts: tuple[int, int, int] = (31, 41, 51)) -> Velocity:
    low = triple([-(count - 1) / 2.0 for count in counts[::-1]])
    field = Velocity(low, (1.0, 1.0, 1.0), np.zeros((*counts, 3)), np.ones(counts, dtype=np.bool_))
    velocity = flow.velocity(field.positions_mm.reshape(-1, 3), 0.0)
    return replace(field, velocity_mm_s=velocity.reshape(*counts, 3))


def rotation() -> Velocity:
    gradient = [[0.0, -3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    return on_lattice(generator_of({"generator": "linear_flow", "gradient_1_s": gradient}))


def test_a_rotation_s_circulation_is_its_vorticity_times_the_area() -> None:
    velocity = interpolate_field(rotation(), rotation().velocity_mm_s)
    half = half_plane((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 0.0)
    assert_allclose(np.cross(half.outward, half.axis), half.normal)
    found = circulation(velocity, half, 6.0, 1.0, 8.0, 5.0)
    assert found == pytest.approx(6.0 * 8.0 * 5.0 * half.normal[2], rel=1e-9)
    assert np.isnan(circulation(velocity, half, 20.0, 0.0, 12.0, 4.0))


def test_a_planar_field_has_the_same_circulation_in_its_plane() -> None:
    solid, point = rotation(), np.array([[1.0, 2.0, 0.3]])
    half = half_plane((0.0, 0.0, 0.3), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), 0.0)
    layer = solid.velocity_mm_s[:1], solid.valid[:1]
    plane = Velocity((*solid.low_mm[:2], 0.3), solid.step_mm, *layer, np.eye(3)[:2])
    values = [interpolate_field(one, one.velocity_mm_s) for one in (solid, plane)]
    one, other = (circulation(each, half, 6.0, 1.0, 8.0, 5.0) for each in values)
    assert one == pytest.approx(other)
    assert_allclose(spin_of(plane)(point), [[0.0, 0.0, 6.0]])
    assert np.isnan(spin_of(plane)(point + 0.6)).all()


def test_a_gradient_has_no_circulation() -> None:
    """Its values at a rectangle's opposite ends differ, and add up to nothing all the same."""

    def gradient_of_a_cubic(points: F64) -> F64:
        x, y, z = points.T
        return np.column_stack([2.0 * x * y + z, x**2 - y * z, x - 0.5 * y**2])

    half = half_plane((1.0, -2.0, 0.5), (0.2, 1.0, -0.1), (1.0, 0.0, 0.0), 25.0)
    found = circulation(gradient_of_a_cubic, half, 6.0, 1.0, 8.0, 5.0)
    assert found == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("degrees", [0.0, 40.0, 180.0])
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
def test_a_ring_is_found_at_every_angle(degrees: float, axis: tuple[float, float, float]) -> None:
    """A square's circulation lies between those of its inner and outer circles (equation 2.14)."""
    sizes = {"diameter_mm": 20.0, "core_mm": 4.0, "peak_mm_s": 50.0}
    ring = generator_of({"generator": "vortex_ring", "axis": axis, **sizes})
    half = half_plane((0.0, 0.0, 0.0), axis, (1.0, 0.3, 0.1), degrees)
    found = circulation(lambda points: ring.velocity(points, 0.0), half, 10.0, 0.0, 12.0, 12.0)
    inner, outer = (
        2.0 * np.pi * np.e * 50.0 * radius**2 * np.exp(-radius / 4.0) / 4.0
        for radius in (6.0, 6.0 * np.sqrt(2.0))
    )
    assert inner < abs(found) < outer
    field = on_lattice(ring)
    r, z, spin = core(spin_of(field), half, 10.0, 4.0)
    assert_allclose((r, z), (10.0, 0.0), atol=0.8)
    assert np.sign(spin) == np.sign(found)
    assert np.isnan(core(spin_of(field), half, 60.0, 4.0)).all()


def test_the_response_is_the_slope() -> None:
    true = np.random.default_rng(0).standard_normal((500, 3)) + 7.0
    assert_allclose(response(0.8 * true - 5.0, true), 0.8)
    assert_allclose(response(true.mean(axis=0) + 0.0 * true, true), 0.0, atol=1e-12)
    assert np.isnan(response(true, np.ones_like(true)))
    assert np.isnan(response(true[:0], true[:0]))


def picture(*panels: Panel) -> F64:
    png = np.frombuffer(draw(Figure("f", "a figure", panels)), dtype=np.uint8)
    return np.asarray(cv2.imdecode(png, cv2.IMREAD_COLOR), dtype=np.float64)


def test_slices_are_the_right_way_up() -> None:
    """Positive values are red; the first row is at the top."""
    values: F64 = np.kron(np.diag([1.0, -1.0]), np.ones((10, 10))).astype(np.float64)
    axis, arrows = np.arange(20.0), np.full((20, 20, 2), np.nan)
    part = Slice("", axis, axis, values, signed=True, arrows=arrows)
    image = picture(Panel("", "x", "y", (part,)))[:, :330]  # without the scale
    red, blue = image[..., 2] - image[..., 0] > 60, image[..., 0] - image[..., 2] > 60
    assert (np.argwhere(red).mean(axis=0) < np.argwhere(blue).mean(axis=0)).all()


def test_pictures_are_the_right_way_up_and_rings_lie_where_they_should() -> None:
    values, size = np.zeros((20, 40)), ((0.0, 100.0), (39.0, 119.0))
    values[:10, :10] = 1.0
    bare = picture(Panel("", "", "", (Picture(values, *size),)))
    ringed = picture(Panel("", "", "", (Picture(values, *size, np.array([[35.0, 115.0, 3.0]])),)))
    black = np.argwhere(bare.max(axis=2) < 5.0)  # all but the upper left, and letters
    inside = np.argwhere((ringed[..., 2] - ringed[..., 0] > 100.0) & (bare.max(axis=2) < 60.0))
    assert len(inside) > 20
    assert (inside.mean(axis=0) > black.mean(axis=0)).all()
