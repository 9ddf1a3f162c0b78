"""Corrections of tomography, each against its formula with a dense W."""

from collections.abc import Callable

import numba
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.tomography import art_updates
from sabench.algorithms.tomography.art_updates import STRIP
from sabench.algorithms.tomography.projection_operator import (
    BILINEAR,
    Footprint,
    ProjectionOperator,
)
from sabench.utils.arrays import F32, F64
from tests.unit.algorithms.refocus.test_synthetic_aperture import TILTED
from tests.unit.algorithms.tomography.test_projection_operator import (
    BLOB,
    COLUMNS,
    ROWS,
    array,
    lines_of,
)

Step = Callable[[art_updates.Iterate, art_updates.RecordedLight], float]


def lengths_of(state: art_updates.Iterate) -> F32:
    return state.lines.forward(np.ones_like(state.values))


STEPS: dict[str, Step] = {
    "smart": lambda state, measured: art_updates.smart(state, measured, 0.9),
    "sart": lambda state, measured: art_updates.sart(state, measured, lengths_of(state), 0.8),
    "block_mart": lambda state, measured: art_updates.block_mart(state, measured, 0.7),
    "mart": lambda state, measured: art_updates.mart(state, measured, 0.9),
}
WHITE = np.ones((3, ROWS, COLUMNS), dtype=np.float32)
NOWHERE = np.zeros(WHITE.shape, dtype=np.bool_)


def matrices(lines: ProjectionOperator) -> F64:
    """W (camera, pixel, voxel), column by column, by one thread, which is faster here."""
    unit, most = np.eye(len(lines.support), dtype=np.float32), numba.get_num_threads()
    numba.set_num_threads(1)
    columns = [lines.forward(row).reshape(len(lines.cameras), -1) for row in unit]
    numba.set_num_threads(most)
    return np.stack(columns, axis=-1).astype(np.float64)


def make_state(footprint: Footprint = BLOB, every: int = 4) -> art_updates.Iterate:
    lines = lines_of(array(TILTED), footprint, every=every)
    seen = np.maximum(np.rint(lines.adjoint(WHITE)), np.float32(1.0))
    values = np.random.default_rng(1).random(len(lines.support), dtype=np.float32)
    return art_updates.Iterate(lines, values + np.float32(0.5), seen)


def with_values(state: art_updates.Iterate, values: F32) -> art_updates.Iterate:
    return art_updates.Iterate(state.lines, values, state.seen)


def recorded(state: art_updates.Iterate, seed: int) -> art_updates.RecordedLight:
    values = np.random.default_rng(seed).random(len(state.values), dtype=np.float32)
    light = state.lines.forward(values * np.float32(2.0))
    return art_updates.RecordedLight(np.maximum(light, np.float32(1e-6)), NOWHERE)


def by_formula(name: str, w: F64, p: F64, values: F64) -> F64:
    """One iteration with a dense W (camera, pixel, voxel) and P (camera, pixel)."""
    seen = np.maximum(w.sum(axis=(0, 1)), 1.0)
    cast = w @ values
    if name == "smart":
        ratio = np.divide(p, cast, out=np.ones_like(p), where=cast > 0.0)
        return np.asarray(values * np.exp(0.9 * np.tensordot(np.log(ratio), w, 2) / seen))
    if name == "sart":
        lengths = w.sum(axis=2)
        missing = np.divide(p - cast, lengths, out=np.zeros_like(p), where=lengths > 0.0)
        return np.asarray(np.maximum(values + 0.8 * np.tensordot(missing, w, 2) / seen, 0.0))
    for camera, image in zip(w, p, strict=True):
        if name == "mart":
            values = mart_by_formula(camera, image, values)
            continue
        cast = camera @ values
        ratio = np.divide(image, cast, out=np.ones_like(image), where=cast > 0.0)
        values = values * np.exp(0.7 * camera.T @ np.log(ratio))
    return values


def mart_by_formula(w: F64, p: F64, values: F64) -> F64:
    """Pixel after pixel: even strips of rows, then odd ones."""
    rows = [row for parity in (0, 1) for row in range(ROWS) if row // STRIP % 2 == parity]
    for pixel in (row * COLUMNS + column for row in rows for column in range(COLUMNS)):
        cast = float(w[pixel] @ values)
        if cast > 0.0:
            values = values * (p[pixel] / cast) ** (0.9 * w[pixel])
    return values


@pytest.mark.slow
@pytest.mark.parametrize(("name", "footprint"), [*zip(STEPS, [BLOB, BILINEAR] * 2, strict=True)])
def test_steps_follow_their_formulas(name: str, footprint: Footprint) -> None:
    state = make_state(footprint)
    measured = recorded(state, 2)
    w, p = matrices(state.lines), measured.light.reshape(3, -1).astype(np.float64)
    expected = state.values.astype(np.float64)
    for _ in range(3):
        STEPS[name](state, measured)
        expected = by_formula(name, w, p, expected)
    assert_allclose(state.values, expected, rtol=2e-4, atol=1e-4)
    assert np.ptp(state.values) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
def test_saturated_pixels_only_make_voxels_brighter(name: str) -> None:
    state = make_state()
    measured, before = recorded(state, 2), state.values.copy()
    everywhere = art_updates.RecordedLight(measured.light, ~NOWHERE)
    bright = with_values(state, before * np.float32(50.0))
    missed = np.maximum(measured.light - bright.lines.forward(bright.values), 0.0)
    expected = (missed.astype(np.float64) ** 2).sum()  # only what was not projected
    assert STEPS[name](bright, everywhere) == pytest.approx(expected, rel=1e-4)
    assert_allclose(bright.values, before * 50.0, rtol=1e-6)
    assert STEPS[name](bright, measured) > 0.0
    assert (bright.values < before * 40.0).mean() > 0.8
    dark = [with_values(state, before * np.float32(0.02)) for _ in range(2)]
    for one, light in zip(dark, (measured, everywhere), strict=True):
        STEPS[name](one, light)
    assert (dark[1].values > before * 0.03).mean() > 0.8
    if name in ("smart", "sart"):  # in between, the others turn to cameras that may see too much
        assert_allclose(dark[0].values, dark[1].values, rtol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
def test_steps_do_not_depend_on_the_number_of_threads(name: str) -> None:
    most, found = numba.get_num_threads(), []
    for threads in (1, most, most):
        numba.set_num_threads(threads)
        state = make_state()
        found.append((STEPS[name](state, recorded(state, 3)), state.values))
    for missed, values in found[1:]:
        assert missed == found[0][0]
        assert_array_equal(values, found[0][1])


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
def test_first_residual_is_what_the_first_values_miss(name: str) -> None:
    state = make_state()
    measured = recorded(state, 4)
    missing = measured.light.astype(np.float64) - state.lines.forward(state.values)
    found = STEPS[name](state, measured)
    if name in ("smart", "sart"):
        assert found == pytest.approx((missing**2).sum(), rel=1e-4)
    else:  # later cameras, or pixels, find voxels that are corrected already
        assert 0.05 * (missing**2).sum() < found < (missing**2).sum()


@pytest.mark.slow
@pytest.mark.parametrize("name", STEPS)
def test_residual_falls_until_the_images_are_explained(name: str) -> None:
    state = make_state(every=9)
    bright = np.where(np.arange(len(state.values)) % 7 == 0, np.float32(1.0), np.float32(1e-3))
    light = np.maximum(state.lines.forward(bright), np.float32(art_updates.DARKEST))
    measured = art_updates.RecordedLight(light, NOWHERE)
    residuals = list(
        art_updates.iterate(lambda: STEPS[name](state, measured), measured, 40, 0.0, name)
    )
    assert len(residuals) == 40
    assert (np.diff(residuals[:10]) < 0.0).all()
    assert residuals[-1] < 0.1 * residuals[0]


def test_iteration_stops_when_little_changes() -> None:
    measured = art_updates.RecordedLight(2.0 * WHITE[:1, :2, :2], NOWHERE[:1, :2, :2])
    squares = iter([16.0, 4.0, 3.24, 3.0, 1.0])
    found = list(art_updates.iterate(lambda: next(squares), measured, 5, 0.15, "test"))
    assert_allclose(found, [1.0, 0.5, 0.45])


@pytest.mark.parametrize("name", STEPS)
def test_black_pixels_leave_no_light_but_finite_values(name: str) -> None:
    state, black = make_state(), np.float32(art_updates.DARKEST) * WHITE
    measured = art_updates.RecordedLight(black, NOWHERE)
    for _ in range(5):
        STEPS[name](state, measured)
    assert np.isfinite(state.values).all()
    assert state.values[state.lines.adjoint(WHITE) > 0.5].max() < 0.5


@pytest.mark.slow
def test_a_voxel_that_one_camera_sees_is_led_by_that_camera() -> None:
    """The last camera changes voxels less, the more cameras see them."""
    state = make_state(every=1)
    lines = state.lines
    counts, last = np.rint(lines.adjoint(WHITE)), np.rint(lines.adjoint(WHITE[2:], [2])) > 0.0
    assert set(np.unique(counts[last])) == {2.0, 3.0}
    assert set(np.unique(counts[~last])) == {1.0, 2.0}
    measured = recorded(state, 5)
    other = art_updates.RecordedLight(measured.light.copy(), measured.saturated)
    other.light[2] *= np.float32(3.0)
    results = []
    for what in (measured, other):
        fresh = with_values(state, state.values.copy())
        art_updates.smart(fresh, what, 1.0)
        results.append(fresh.values)
    assert_array_equal(results[0][~last], results[1][~last])
    assert_allclose(results[1][last], results[0][last] * 3.0 ** (1.0 / counts[last]), rtol=1e-4)
