"""Voxel grids, ideal fields, and maps of planes against exact projection."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull
from scipy.stats import norm

from sabench.geometry.grid import Grid, check_volume, cut_box, synthesise
from sabench.geometry.lens import Distortion
from sabench.geometry.plane_polynomials import TOLERANCE_PX, plane_maps
from sabench.geometry.refraction import Wall
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.utils import memory
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused
from tests.unit.algorithms.refocus.test_synthetic_aperture import BROWN, FLAT, TILTED, make_camera

GRID = Grid((-4.0, 2.0, 40.0), (0.25, 0.2, 0.5), (12, 30, 41), crop=(3, 2, 1))


def test_axes_are_x_y_z_and_volumes_z_y_x() -> None:
    x, y, z = GRID.axes_mm
    assert (len(x), len(y), len(z)) == (41, 30, 12)
    assert_allclose([x[0], x[-1], y[0], y[-1], z[0], z[-1]], [-4.0, 6.0, 2.0, 7.8, 40.0, 45.5])
    place = np.array([[-4.0 + 0.25 * 7, 2.0 + 0.2 * 5, 40.0 + 0.5 * 3]])
    assert_allclose(GRID.to_voxels(place), [[7.0, 5.0, 3.0]])
    assert np.zeros(GRID.shape)[GRID.scored].shape == (10, 26, 35)


def test_scored_part_is_the_same_for_voxels_and_positions() -> None:
    mask = np.zeros(GRID.shape, dtype=np.bool_)
    mask[GRID.scored] = True
    z, y, x = np.meshgrid(*(np.arange(n) for n in GRID.shape), indexing="ij")
    voxels = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float64)
    for shift in (-0.499, 0.0, 0.499):
        assert_array_equal(GRID.in_scored(voxels + shift), mask.ravel())


def test_a_volume_that_fills_the_memory_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    need_mb = 12 * 30 * 41 * 4 / 1e6
    for there in (None, need_mb, 2.0 * need_mb):
        monkeypatch.setattr(memory, "available_mb", lambda there=there: there)
        check_volume(GRID)
    monkeypatch.setattr(memory, "available_mb", lambda: 0.99 * need_mb)
    with refused("12 x 30 x 41"):
        check_volume(GRID)


@pytest.mark.parametrize("sigma", [0.1, 0.5])
def test_voxels_are_the_means_of_the_gaussian_over_them(sigma: float) -> None:
    place = np.array([0.13, 4.91, 42.7])
    found = synthesise(GRID, place[None], np.array([2.0]), sigma)
    means = []
    for axis, voxel, at in zip(GRID.axes_mm, GRID.voxel_mm, place, strict=True):
        share = np.diff(norm.cdf(np.append(axis, axis[-1] + voxel) - voxel / 2.0, at, sigma))
        means.append(share * math.sqrt(2.0 * math.pi) * sigma / voxel)
    expected = 2.0 * np.einsum("i,j,k->kji", *means)
    assert_allclose(found, expected, rtol=1e-5, atol=1e-4 * expected.max())
    assert found.sum() == pytest.approx(expected.sum(), rel=3e-4)


def on_plane(z_mm: float, unit: F64) -> F64:
    x, y, _ = GRID.axes_mm
    across = (x[0] + x[-1]) / 2.0 + unit[:, 0] * (x[-1] - x[0]) / 2.0
    down = (y[0] + y[-1]) / 2.0 + unit[:, 1] * (y[-1] - y[0]) / 2.0
    return np.column_stack([across, down, np.full(len(unit), z_mm)])


def evaluated(coefficients: F64, degree: int, unit: F64) -> F64:
    """The documented polynomial: terms by the power of v, then of u, up to a total degree."""
    powers = [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]
    terms = np.stack([unit[:, 0] ** i * unit[:, 1] ** j for i, j in powers])
    return np.asarray((coefficients @ terms).T)


@pytest.mark.parametrize("wall", [None, TILTED])
@pytest.mark.parametrize("lens", [Distortion(), BROWN])
def test_plane_maps_stay_within_their_tolerance(wall: Wall | None, lens: Distortion) -> None:
    cameras = [make_camera(120.0, -80.0, wall, lens), make_camera(-90.0, 130.0, wall, lens)]
    unit = np.random.default_rng(4).uniform(-1.0, 1.0, (1500, 2))
    for z, plane in zip(GRID.axes_mm[2], plane_maps(cameras, GRID), strict=True):
        for camera, part in zip(cameras, plane, strict=True):
            exact = camera.project(on_plane(z, unit))[0]
            off = evaluated(part.coefficients, part.degree, unit) - exact
            error = np.linalg.norm(off, axis=1).max()
            assert part.error_px <= TOLERANCE_PX
            assert error <= TOLERANCE_PX
            assert error <= 1.2 * part.error_px + 1e-9  # measured between the nodes


def test_plane_without_a_light_path_is_refused() -> None:
    with refused(kind=ValueError):
        plane_maps(
            [make_camera(0.0, 0.0, FLAT)], Grid((-4.0, 2.0, 3.0), (0.25, 0.2, 0.5), (1, 30, 41))
        )


def test_a_part_of_a_grid_has_the_values_of_the_whole() -> None:
    """All lengths are multiples of 1/64 mm, so that both grids see the same positions."""
    part = Grid((0.0, 0.0, 0.0), (0.25, 0.5, 1.0), (6, 10, 20))
    whole = Grid((-10.0, -20.0, -40.0), (0.25, 0.5, 1.0), (86, 90, 100))
    rng = np.random.default_rng(7)
    positions = rng.integers(-64 * 5, 64 * 11, (4000, 3)) / 64.0
    weights, sigma = rng.uniform(0.5, 1.0, 4000), 0.4
    inside = synthesise(whole, positions, weights, sigma)[40:46, 40:50, 40:60]
    assert_array_equal(synthesise(part, positions, weights, sigma), inside)
    alone = np.array([[-1.85, 2.0, 3.0], [2.0, 2.0, -2.4]])  # reach voxel 0 by their last value
    for position in alone:
        at = np.round(64.0 * position[None]) / 64.0
        field = synthesise(part, at, np.ones(1), sigma)
        assert_array_equal(field, synthesise(whole, at, np.ones(1), sigma)[40:46, 40:50, 40:60])
        assert field.max() > 0.0


def test_a_particle_wider_than_the_field_fills_it_evenly() -> None:
    field = synthesise(GRID, np.full((300, 3), 0.5), np.full(300, 2.0), 1e6)
    assert_allclose(field, np.full(GRID.shape, 600.0), rtol=1e-5)


@pytest.mark.parametrize("far_mm", [1e3, 1e12, 1e30])
def test_particles_however_far_away_add_nothing(far_mm: float) -> None:
    positions = far_mm * np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1.0, -1.0, 1.0]])
    assert not synthesise(GRID, positions, np.ones(3), 0.4).any()


LOW, HIGH = np.array([0.0, 0.0, 0.0]), np.array([2.0, 3.0, 4.0])


@pytest.mark.parametrize(
    ("normal", "expected"),
    [
        ([0.0, 0.0, 1.0], 6.0),
        ([1.0, 0.0, 0.0], 12.0),
        ([0.0, 0.8, 0.6], 2.0 * 3.0 / 0.6),  # 3 mm of Y, seen along Z
        ([2.0 / 7.0, 3.0 / 7.0, 6.0 / 7.0], 6.0 / (6.0 / 7.0)),
    ],
)
def test_sections_through_the_middle_have_known_areas(normal: list[float], expected: float) -> None:
    middle, across = (LOW + HIGH) / 2.0, np.array(normal)
    corners = cut_box(LOW, HIGH, middle, across)
    assert_allclose((corners - middle) @ across, 0.0, atol=1e-12)
    assert (corners >= LOW - 1e-12).all()
    assert (corners <= HIGH + 1e-12).all()
    assert ConvexHull(corners @ frame_of_normal(across)[:2].T).volume == pytest.approx(expected)
