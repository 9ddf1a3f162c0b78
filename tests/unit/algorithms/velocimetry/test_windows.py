"""Kernels of window correlation against other programs, vectors against known flows."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from sabench.algorithms.velocimetry import multipass
from sabench.algorithms.velocimetry.deformation import deform_pair, spline_coefficients
from sabench.algorithms.velocimetry.windows import Windows, block_sums, by_shifts, by_spectra
from sabench.api import Velocity, VolumePair
from sabench.geometry.grid import Grid, gradient, inner, synthesise
from sabench.metrics.velocity_error import precision_interval, response
from sabench.plugins import load
from sabench.utils.arrays import F32, F64
from sabench.worlds.advection import advect
from tests.helpers.refusals import refused

GRID = Grid((-4.0, -4.0, -2.0), (0.05, 0.05, 0.1), (40, 160, 160))
WINDOW = (16, 32, 32)


def particles(per_mm3: float = 5.0) -> F64:
    """More than the grid holds, so that some enter and leave."""
    end = np.array([5.0, 5.0, 3.0])
    return np.random.default_rng(0).uniform(-end, end, (round(600.0 * per_mm3), 3))


def volume(points: F64) -> F32:
    return synthesise(GRID, points, np.ones(len(points)), 0.05)


def pair_of(name: str, **parameters: Any) -> tuple[VolumePair, Any]:
    plugin = load("generators", name)
    flow, start = plugin(plugin.Parameters(**parameters)), particles()
    return VolumePair(volume(start), volume(advect(flow, start, 0.0, 1.0, 1e-7)), GRID, 1.0), flow


def errors(field: Velocity, flow: Any) -> F64:
    """Errors of valid vectors from displacements about the middle of the interval, in voxels."""
    points = field.positions_mm.reshape(-1, 3)
    exact = advect(flow, points, 0.5, 1.0, 1e-7) - advect(flow, points, 0.5, 0.0, 1e-7)
    off = (field.velocity_mm_s.reshape(-1, 3) - exact) / np.asarray(GRID.voxel_mm)
    return np.asarray(off[field.valid.ravel()])


def solved(case: VolumePair, name: str = "piv3d", **parameters: Any) -> Velocity:
    plugin = load("solvers", name)
    made: Velocity = plugin(plugin.Parameters(**parameters)).solve(case)
    return made


@pytest.mark.parametrize("shape", [(20, 40, 50), (3, 9, 2)])
def test_spline_coefficients_are_scipy_s(shape: tuple[int, int, int]) -> None:
    values = np.random.default_rng(1).random(shape).astype(np.float32)
    expected = spline_filter(values.astype(np.float64), 3, mode="mirror")
    assert_allclose(spline_coefficients(values), expected, atol=2e-5)


def test_moved_volumes_are_scipy_s() -> None:
    rng = np.random.default_rng(2)
    volumes = rng.random((2, 20, 40, 50)).astype(np.float32)
    field, origin, step = rng.normal(0.0, 1.5, (4, 5, 6, 3)), (2.0, 3.0, 4.0), (4.0, 8.0, 8.0)
    out = np.empty((2, 20, 40, 50), dtype=np.float32)
    rows = slice(0, math.prod(out[0].shape[:2]))
    deform_pair(
        rows, *(spline_coefficients(values) for values in volumes), field, origin, step, *out
    )
    place = np.mgrid[:20, :40, :50].astype(np.float64)
    shift = _continued(field, [(place[i] - origin[i]) / step[i] for i in range(3)])
    found, both = [], np.ones((20, 40, 50), dtype=np.bool_)
    for values, share in zip(volumes, (-0.5, 0.5), strict=True):
        there = place + share * shift
        found.append(map_coordinates(values.astype(np.float64), there, order=3, mode="mirror"))
        last = np.array(values.shape)[:, None, None, None] - 1
        both &= ((there >= 0.0) & (there <= last)).all(axis=0)
    for made, expected in zip(out, found, strict=True):
        assert_allclose(made[both], expected[both], atol=5e-6)
        assert not made[~both].any()


def _continued(field: F64, at: list[F64]) -> F64:
    """Displacements (z, y, x) at positions on a lattice, which is continued linearly."""
    room = 4
    for axis in range(3):
        before, second, other, after = (np.take(field, [n], axis=axis) for n in (0, 1, -2, -1))
        low = [before + n * (before - second) for n in range(room, 0, -1)]
        high = [after + n * (after - other) for n in range(1, room + 1)]
        field = np.concatenate([*low, field, *high], axis=axis)
    places = [own + room for own in at]
    return np.stack([map_coordinates(field[..., 2 - i], places, order=1) for i in range(3)])


def test_block_sums_are_sums() -> None:
    first, second = np.random.default_rng(3).random((2, 12, 16, 24)).astype(np.float32)
    products, squares = (np.empty((3, 2, 3, 3 * 5 * 5), dtype=np.float32) for _ in range(2))
    block_sums(
        slice(0, math.prod(products.shape[:2])),
        first,
        second,
        (4, 8, 8),
        (1, 2, 2),
        products,
        squares,
    )
    padded = np.pad(second, ((1, 1), (2, 2), (2, 2)))
    for (dz, dy, dx), place in np.ndenumerate(np.arange(75).reshape(3, 5, 5)):
        other = padded[dz : dz + 12, dy : dy + 16, dx : dx + 24]
        for sums, values in ((products, first * other), (squares, other * other)):
            expected = values.reshape(3, 4, 2, 8, 3, 8).sum(axis=(1, 3, 5))
            assert_allclose(sums[..., place], expected, rtol=1e-4)


def test_small_shifts_are_found_to_parts_of_a_voxel() -> None:
    start, shift = particles(), np.array([0.3, -0.45, 0.2])
    windows = Windows.over(GRID.shape, WINDOW, 0.5)
    moved = volume(start + shift * np.asarray(GRID.voxel_mm))
    peaks = by_shifts(volume(start), moved, windows, (1, 1, 1))
    assert np.abs(peaks.shift.mean(axis=(0, 1, 2)) - shift).max() < 0.04
    assert peaks.height.min() > 0.7
    dim = np.float32(2.0**-20)  # a window counts as empty below a part of the mean
    faint = by_shifts(dim * volume(start), dim * moved, windows, (1, 1, 1))
    assert_allclose(faint.shift, peaks.shift, atol=1e-6)
    assert_allclose(faint.height, peaks.height, atol=1e-6)
    half = np.where(
        np.arange(GRID.shape[2]) < GRID.shape[2] // 2, np.float32(2.0**-7), np.float32(1.0)
    )
    dark = by_shifts(half * volume(start), half * moved, windows, (1, 1, 1))
    assert not dark.height[..., 0].any()


def test_large_shifts_are_found_by_spectra() -> None:
    start, shift = particles(), np.array([7.2, -9.6, 3.3])
    windows = Windows.over(GRID.shape, WINDOW, 0.5)
    moved = volume(start + shift * np.asarray(GRID.voxel_mm))
    peaks: Any = by_spectra(volume(start), moved, windows)
    good = np.abs(peaks.shift - shift).max(axis=-1) < 0.5
    assert good.mean() > 0.9
    assert np.median(peaks.ratio[good]) > 1.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("linear_flow", {"velocity_mm_s": (0.21, -0.13, 0.17)}),
        ("linear_flow", {"gradient_1_s": ((0.0, 0.06, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))}),
        ("lamb_oseen_vortex", {"core_mm": 2.0, "circulation_mm2_s": 3.0}),
    ],
)
def test_known_flows_are_measured(name: str, parameters: dict[str, Any]) -> None:
    case, flow = pair_of(name, **parameters)
    field = solved(case)
    off = errors(field, flow)
    assert field.valid.mean() > 0.98
    assert (precision_interval(off) < [0.06, 0.06, 0.1]).all()
    # along Z a particle is half a voxel wide: no interpolation is right there
    assert (np.abs(off.mean(axis=0)) < [0.01, 0.01, 0.03]).all()


@pytest.mark.slow
def test_the_plain_method_is_worse_and_still_right() -> None:
    case, flow = pair_of("lamb_oseen_vortex", core_mm=2.0, circulation_mm2_s=3.0)
    plain, better = (
        precision_interval(errors(solved(case, name), flow)) for name in ("piv3d_plain", "piv3d")
    )
    assert (better[:2] < plain[:2]).all()
    assert plain.max() < 0.6


@pytest.mark.slow
def test_vectors_lie_at_the_middles_of_their_windows() -> None:
    case, _ = pair_of("linear_flow", velocity_mm_s=(0.1, 0.0, 0.0))
    field = solved(case, overlap=0.5)
    assert field.valid.shape == (4, 9, 9)
    first = np.asarray(GRID.low_mm) + np.asarray(GRID.voxel_mm) * [15.5, 15.5, 7.5]
    assert_allclose(field.positions_mm[0, 0, 0], first)
    assert_allclose(field.step_mm, [0.8, 0.8, 0.8])


@pytest.mark.slow
def test_windows_without_signal_are_invalid_and_finite() -> None:
    case, _ = pair_of("linear_flow", velocity_mm_s=(0.1, 0.0, 0.0))
    first, second = case.first.copy(), case.second.copy()
    first[:, :, 80:], second[:, :, 80:] = 0.0, 0.0
    field = solved(VolumePair(first, second, GRID, 1.0))
    dark = field.positions_mm[..., 0] > 0.05 * (80 + 20) - 4.0
    assert not field.valid[dark].any()
    assert field.valid[~dark].mean() > 0.7
    assert np.isfinite(field.velocity_mm_s).all()


def test_impossible_windows_are_named() -> None:
    case, _ = pair_of("linear_flow")
    with refused("window", "160 x 160"):
        solved(case, window=(320, 32, 16))
    with refused("overlap", "32 x 32 x 16"):
        solved(case, overlap=0.7)


def test_outliers_are_found_and_filled() -> None:
    z, y, x = np.mgrid[:8, :10, :12].astype(np.float64)
    smooth = np.stack([0.2 * y, -0.1 * x, 0.05 * z], axis=-1)
    spoilt, valid = smooth.copy(), np.ones(smooth.shape[:3], dtype=np.bool_)
    places = [(3, 4, 5), (6, 8, 2)]
    for place in places:
        spoilt[place] += [2.0, -1.5, 1.0]
    for kept in (
        multipass.near_the_median(spoilt, valid, 2.0),
        multipass.thesis_local(spoilt, valid, 3.0),
    ):
        assert not any(kept[place] for place in places)
        assert kept.mean() > 0.98
    repaired = multipass.fill_invalid(spoilt, multipass.near_the_median(spoilt, valid, 2.0))
    assert np.abs(repaired - smooth)[1:-1, 1:-1, 1:-1].max() < 0.1
    far = smooth.copy()
    far[2, 2, 2] += 50.0
    assert not multipass.within_deviations(far, valid, 5.0)[2, 2, 2]
    assert not multipass.fill_invalid(spoilt, np.zeros_like(valid)).any()


def test_gradients_are_those_of_linear_fields() -> None:
    slope = np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 0.5], [4.0, 0.0, 0.0]])
    shape, step = (4, 5, 6), (0.5, 0.4, 0.8)
    field = Velocity((0.0,) * 3, step, np.zeros((*shape, 3)), np.ones(shape, dtype=np.bool_))
    found = gradient(field.positions_mm @ slope.T, step)[inner(shape)]
    assert_allclose(found, np.tile(slope, (24, 1, 1)), atol=1e-12)


def test_medians_are_those_of_the_neighbours() -> None:
    rng = np.random.default_rng(5)
    padded = rng.normal(0.0, 1.0, (5, 6, 7, 3))
    padded[rng.random((5, 6, 7)) < 0.3] = np.nan
    padded[:3, :3, :3] = np.nan
    middle, spread = np.empty((3, 4, 5, 3)), np.empty((3, 4, 5, 3))
    multipass.medians(slice(0, math.prod(middle.shape[:2])), padded, middle, spread)
    for z, y, x in np.ndindex(3, 4, 5):
        around = np.delete(padded[z : z + 3, y : y + 3, x : x + 3].reshape(27, 3), 13, axis=0)
        known = around[np.isfinite(around[:, 0])]
        if len(known):
            median = np.median(known, axis=0)
            assert_allclose(middle[z, y, x], median)
            assert_allclose(spread[z, y, x], np.median(np.abs(known - median), axis=0))
        else:
            assert np.isnan(middle[z, y, x]).all()


def test_widths_are_those_of_the_particles() -> None:
    places = particles(8.0)
    for sigma in (0.05, 0.1):
        z, y, x = multipass.widths(synthesise(GRID, places, np.ones(len(places)), sigma))
        for found, voxel in ((z, 0.1), (y, 0.05), (x, 0.05)):
            assert found == pytest.approx(np.hypot(sigma / voxel, np.sqrt(1.0 / 12.0)), rel=0.1)
    assert multipass.widths(np.ones((4, 5, 6), dtype=np.float32)) == (np.inf, np.inf, np.inf)


def test_narrow_particles_are_widened_by_a_gaussian() -> None:
    values = np.random.default_rng(0).random((20, 30, 40)).astype(np.float32)
    sigma = [np.sqrt(1.2**2 - 0.4**2), 0.0, np.sqrt(1.2**2 - 0.9**2)]
    expected = gaussian_filter(
        values, sigma, mode="mirror", radius=[int(np.ceil(3.0 * own)) for own in sigma]
    )
    assert_allclose(multipass.widen(values, (0.4, 1.3, 0.9), 1.2), expected, atol=1e-5)
    assert multipass.widen(values, (0.8, 0.9, 1.0), 0.8) is values


@pytest.mark.slow
def test_weighted_windows_resolve_more() -> None:
    """Of a wave twice as long as the window."""
    parameters = {"along": (1.0, 0.0, 0.0), "across": (0.0, 1.0, 0.0)}
    case, flow = pair_of("shear_wave", wavelength_mm=3.2, peak_mm_s=0.05, **parameters)
    found = []
    for taper in (None, 0.25):
        field = solved(case, first_window=(32, 32, 16), passes=1, taper=taper)
        valid = field.valid
        exact = flow.velocity(field.positions_mm[valid], 0.5)
        found.append(response(field.velocity_mm_s[valid], exact))
    assert 0.5 < found[0] < found[1] < 1.05
