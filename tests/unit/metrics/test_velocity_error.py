"""Errors of velocity fields whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull

from sabench.api import Velocity
from sabench.geometry.grid import Grid, cut_box
from sabench.metrics.velocity_error import (
    evaluation_lattice,
    planar_lattice,
    precision_interval,
    sample_velocity,
    velocity_scores,
)
from sabench.utils.arrays import F64, Bool, triple

STEP_MM = (0.5, 0.4, 0.8)
VOXEL_MM = (0.1, 0.2, 0.05)
SHAPE = (4, 5, 6)


def linear(slopes: F64) -> F64:
    """A field u_i = sum_j slopes[i, j] x_j on the lattice (z, y, x, 3)."""
    axes = [step * np.arange(count) for step, count in zip(STEP_MM, SHAPE[::-1], strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    return np.asarray(np.stack([x, y, z], axis=-1).transpose(2, 1, 0, 3) @ slopes.T)


def scores(estimate: F64, truth: F64, valid: Bool | None = None) -> dict[str, float]:
    there = np.ones(SHAPE, dtype=np.bool_) if valid is None else valid
    return velocity_scores(estimate, truth, there, np.ones_like(there), STEP_MM, 0.02, VOXEL_MM)


def test_a_constant_error_is_a_bias_in_voxels() -> None:
    truth = linear(np.diag([1.0, 2.0, 3.0]))
    got = scores(truth + np.array([1.0, -2.0, 1.5]), truth)
    errors = {"u": 0.2, "v": -0.2, "w": 0.6}
    for axis, error in errors.items():
        assert got[f"{axis}_bias_voxel"] == pytest.approx(error)
        assert got[f"{axis}_rms_voxel"] == pytest.approx(abs(error))
        assert got[f"{axis}_p90_voxel"] == pytest.approx(abs(error))
    assert got["bias_voxel"] == pytest.approx(np.sqrt(0.44))
    assert got["rms_voxel"] == pytest.approx(np.sqrt(0.44))
    assert got["divergence_1_s"] == pytest.approx(0.0, abs=1e-9)
    assert got["vorticity_percent"] == pytest.approx(0.0, abs=1e-9)
    assert got["response"] == pytest.approx(1.0)


def test_errors_of_derivatives_are_those_of_a_linear_field() -> None:
    """Errors of slopes a_ij add their trace, and the curl of a_ij - a_ji, to the derivatives."""
    spin = np.array([[0.0, -3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    wrong = np.array([[0.4, 0.0, 0.6], [0.0, 0.5, 0.0], [0.0, 0.8, -0.2]])
    got = scores(linear(spin + wrong), linear(spin))
    assert got["divergence_1_s"] == pytest.approx(0.7)
    # curl: (a_32 - a_23, a_13 - a_31, a_21 - a_12) = (0.8, 0.6, 0)
    assert got["vorticity_percent"] == pytest.approx(100.0 * np.sqrt(0.8**2 + 0.6**2) / 6.0)
    slow = scores(0.01 * linear(spin + wrong), 0.01 * linear(spin))
    assert slow["vorticity_percent"] == pytest.approx(got["vorticity_percent"])


@pytest.mark.parametrize("node", [(1, 2, 2), (3, 2, 2), (2, 2, 0)])
def test_what_was_not_measured_has_no_influence(node: tuple[int, int, int]) -> None:
    truth = linear(np.array([[0.0, -3.0, 1.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]))
    valid = np.ones(SHAPE, dtype=np.bool_)
    valid[node] = False
    estimate = truth.copy()
    estimate[node] = 1e6
    got = scores(estimate, truth, valid)
    assert got["yield_percent"] == pytest.approx(100.0 * 119.0 / 120.0)
    for key in ("rms_voxel", "bias_voxel", "divergence_1_s", "vorticity_percent"):
        assert got[key] == pytest.approx(0.0, abs=1e-9)


def test_nine_tenths_of_the_errors_lie_in_the_interval() -> None:
    errors = np.column_stack([np.linspace(-1.0, 1.0, 2001), np.linspace(0.0, 3.0, 2001)])
    assert_allclose(precision_interval(errors), [0.9, 2.7], rtol=1e-3)


GRID = Grid((-3.0, 1.0, 20.0), (0.05, 0.05, 0.1), (40, 100, 120), (10, 8, 0))
SLOPE = np.array([[1.0, -2.0, 0.5], [0.3, 0.0, -1.0], [2.0, 1.0, -1.0]])


def shear(points_mm: F64) -> F64:
    return np.asarray(points_mm @ SLOPE.T + [4.0, -5.0, 6.0])


def field_of(step_voxels: float, low_voxels: float = 0.0) -> Velocity:
    counts = ((np.asarray(GRID.shape[::-1]) - 1 - low_voxels) // step_voxels + 1).astype(int)
    low = triple(np.asarray(GRID.low_mm) + low_voxels * np.asarray(GRID.voxel_mm))
    step = triple(step_voxels * np.asarray(GRID.voxel_mm))
    valid = np.ones(counts[::-1], dtype=np.bool_)
    field = Velocity(low, step, np.zeros((*valid.shape, 3)), valid)
    return replace(field, velocity_mm_s=shear(field.positions_mm))


def nodes() -> F64:
    return evaluation_lattice(GRID).positions_mm.reshape(-1, 3)


def test_nodes_fill_the_scored_part() -> None:
    voxels = GRID.to_voxels(nodes())
    assert GRID.in_scored(voxels).all()
    scored = np.asarray(GRID.shape[::-1]) - 2 * np.asarray(GRID.crop)
    middle = (np.asarray(GRID.shape[::-1]) - 1) / 2.0
    assert_allclose((voxels.min(axis=0) + voxels.max(axis=0)) / 2.0, middle)
    assert (np.ptp(voxels, axis=0) > scored - 2 * 4.95).all()


@pytest.mark.parametrize(
    ("shape", "counts"),
    [((1, 100, 120), (1, 20, 24)), ((4, 100, 120), (3, 20, 24)), ((2000, 2000, 2000), (31,) * 3)],
)
def test_thin_volumes_have_some_nodes_and_large_ones_not_too_many(
    shape: tuple[int, int, int], counts: tuple[int, int, int]
) -> None:
    assert evaluation_lattice(replace(GRID, shape=shape, crop=(0, 0, 0))).valid.shape == counts


@pytest.mark.parametrize("step", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("low", [0.0, 2.5])
def test_a_linear_field_is_sampled_exactly_between_nodes(step: float, low: float) -> None:
    field = field_of(step, low)
    last = np.asarray(field.valid.shape[::-1]) - 1
    ends = np.asarray(field.low_mm) + np.asarray(field.step_mm) * last
    points = nodes()
    velocity, measured = sample_velocity(field, points)
    between = ((points >= field.low_mm) & (points <= ends)).all(axis=1)
    assert measured[between].all()
    assert_allclose(velocity[between], shear(points[between]), atol=1e-9)


def test_a_node_stands_for_the_cell_around_it() -> None:
    field = field_of(8.0, 20.0)
    points = np.asarray(field.low_mm) + np.outer([-0.51, -0.49, 0.0], field.step_mm)
    velocity, measured = sample_velocity(field, points)
    assert measured.tolist() == [False, True, True]
    assert_array_equal(velocity[1], velocity[2])
    assert_array_equal(velocity[0], np.zeros(3))


def test_nodes_that_are_not_valid_count_for_nothing() -> None:
    field = field_of(8.0)
    field.valid[2, 3, 4] = False
    field.velocity_mm_s[2, 3, 4] = 1e9
    hole = np.asarray(field.low_mm) + np.asarray(field.step_mm) * [4.0, 3.0, 2.0]
    beside = hole + np.asarray(field.step_mm) * [0.6, 0.0, 0.0]
    velocity, measured = sample_velocity(field, np.stack([hole, beside]))
    assert measured.tolist() == [False, True]
    assert_allclose(velocity[1], field.velocity_mm_s[2, 3, 5])


def test_a_lattice_gains_nothing_by_where_its_nodes_lie() -> None:
    """Noise of fields with steps of 8 voxels is averaged alike, wherever their nodes lie."""
    rng, spread = np.random.default_rng(0), []
    for low in (0.0, 1.0, 2.5, 4.0, 6.0):
        field = field_of(8.0, low)
        noise = replace(field, velocity_mm_s=rng.normal(0.0, 1.0, field.velocity_mm_s.shape))
        velocity, measured = sample_velocity(noise, nodes())
        spread.append(velocity[measured].std())
    assert max(spread) < 1.15 * min(spread)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.6, 0.8), (0.48, -0.36, 0.8)])
def test_planar_nodes_fill_the_sheet_in_the_scored_part(normal: tuple[float, float, float]) -> None:
    middle = np.asarray(GRID.low_mm) + (np.asarray(GRID.shape[::-1]) - 1) / 2.0 * GRID.voxel_mm
    lattice = planar_lattice(GRID, middle, np.asarray(normal))
    points = lattice.positions_mm[lattice.valid]
    assert_allclose((points - middle) @ normal, 0.0, atol=1e-12)
    assert GRID.in_scored(GRID.to_voxels(points)).all()
    section = cut_box(*GRID.scored_box_mm, middle, np.asarray(normal))
    area = ConvexHull(section @ lattice.axes[:2].T).volume
    assert len(points) * np.prod(lattice.step_mm[:2]) == pytest.approx(area, rel=0.1)


def test_planar_nodes_of_a_single_plane_are_those_of_its_grid() -> None:
    single = Grid((-3.0, 1.0, 20.0), (0.05, 0.05, 2.0), (1, 100, 120), (10, 8, 0))
    lattice = planar_lattice(single, np.array([0.0, 2.0, 20.0]), np.array([0.0, 0.0, 1.0]))
    expected = evaluation_lattice(single)
    assert_allclose(lattice.positions_mm, expected.positions_mm)
    assert_allclose(lattice.step_mm, expected.step_mm)
    assert lattice.valid.all()


def tilted_field() -> Velocity:
    """A linear field at nodes of a plane across (0, 0.6, 0.8), 0.4 mm deep."""
    axes, shape = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]]), (1, 9, 11)
    still, valid = np.zeros((*shape, 3)), np.ones(shape, bool)
    field = Velocity((1.0, 2.0, 3.0), (0.5, 0.25, 0.4), still, valid, axes)
    return replace(field, velocity_mm_s=shear(field.positions_mm))


def test_a_planar_field_is_measured_in_its_cells_only() -> None:
    field = tilted_field()
    assert_allclose(field.axes[2], [0.0, 0.6, 0.8])
    assert_allclose(field.positions_mm[0, 8, 10], [6.0, 3.6, 1.8])
    inside = field.positions_mm[0, 4, 5] + np.array([0.1, 0.05 * 0.8, -0.05 * 0.6])
    offsets = np.array([0.0, 0.19, -0.19, 0.21, -0.21])[:, None] * field.axes[2]
    velocity, measured = sample_velocity(field, inside + offsets)
    assert measured.tolist() == [True, True, True, False, False]
    assert_allclose(velocity[0], shear(inside[None])[0])


def test_a_planar_field_in_its_own_axes_is_the_same_field() -> None:
    field = tilted_field()
    own = field.in_own_axes()
    assert own.plane_axes is None
    assert_allclose(own.positions_mm @ field.axes, field.positions_mm)
    assert_allclose(own.velocity_mm_s @ field.axes, field.velocity_mm_s)
    flat = field.components(field.velocity_mm_s)
    assert_allclose(flat[..., 2], 0.0)
    assert_allclose(flat[..., :2], own.velocity_mm_s[..., :2])
