"""Particle solvers on wrong or empty input, and within a budget of time."""

import itertools
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from sabench.api import FoundParticles, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.tasks.particles_over_time import find_in_each_frame
from sabench.tasks.solver_call import SolverClock
from sabench.utils.arrays import F64
from sabench.utils.errors import DeclinedError
from tests.helpers.refusals import check_sentence, refused
from tests.helpers.small_particles import count_found, make_small

SOLVERS = ["bayesian_ipr", "shake_the_box"]
FRAMES = 3

both = pytest.mark.parametrize("solver", SOLVERS)


def solve(frames: Sequence[Observation], solver: str = SOLVERS[0]) -> list[FoundParticles]:
    """A single frame is searched alike by both solvers."""
    sequence, each = ImageSequence.of([*frames]), range(len(frames))
    algorithm = make_algorithm(solver, {})
    return list(find_in_each_frame(algorithm, solver, sequence, each, SolverClock()))


def with_images(case: Observation, images: npt.ArrayLike) -> Observation:
    grey = np.clip(np.rint(np.asarray(images, dtype=np.float64)), 0, 65535).astype(np.uint16)
    return replace(case, images=grey)


def shifted(case: Observation, camera: int, columns: float) -> Observation:
    """Shift where a camera is said to see things."""
    cameras: list[Any] = list(case.cameras)
    column, row = cameras[camera].principal_point_px
    cameras[camera] = replace(cameras[camera], principal_point_px=(column + columns, row))
    return replace(case, cameras=tuple(cameras))


def swapped(case: Observation) -> Observation:
    one, other, *rest = case.cameras
    return replace(case, cameras=(other, one, *rest))


def draw(case: Observation, points: F64, noise: float = 2.2) -> Observation:
    """Draw particles (n, 3) of equal light into images of noise."""
    rows, columns = np.mgrid[: case.images.shape[1], : case.images.shape[2]]
    images = np.random.default_rng(7).normal(case.black_dn, noise, case.images.shape)
    for image, camera in zip(images, case.cameras, strict=True):
        for column, row in camera.project(points)[0]:
            image += 300.0 * np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / (2 * 0.7**2))
    return with_images(case, images)


@both
@pytest.mark.parametrize("cameras", [1, 2])
def test_fewer_than_three_cameras_are_declined(solver: str, cameras: int) -> None:
    case = make_small(1).observation
    few = replace(case, images=case.images[:cameras], cameras=case.cameras[:cameras])
    with refused(solver, kind=DeclinedError):
        solve([few], solver)


def test_cameras_without_a_common_view_are_declined() -> None:
    case = make_small(1).observation
    for camera, columns in enumerate([-200.0, 200.0, -600.0, 600.0]):
        case = shifted(case, camera, columns)
    with refused(SOLVERS[0], kind=DeclinedError):
        solve([case])


@both
@pytest.mark.parametrize("level", [0.0, 4095.0])
def test_uniform_images_give_no_particles(solver: str, level: float) -> None:
    case = make_small(1).observation
    uniform = with_images(case, np.full(case.images.shape, level))
    assert [len(one.position_mm) for one in solve([uniform] * FRAMES, solver)] == [0] * FRAMES


@pytest.mark.slow
@both
@pytest.mark.parametrize(
    ("layout", "rows", "noise", "level"),
    [((2, 2), 60, 0.4, 64.0), ((2, 2), 120, 5.0, 94.0), ((3, 3), 60, 20.0, 94.0)],
)
def test_noise_is_no_light(
    solver: str, layout: tuple[int, int], rows: int, noise: float, level: float
) -> None:
    """Neither on black nor on a raised background."""
    case = make_small(1, 1e-5, layout, cameras={"rows": rows, "columns": rows * 4 // 3}).observation
    rng = np.random.default_rng(5)
    frames = [with_images(case, rng.normal(level, noise, case.images.shape)) for _ in range(FRAMES)]
    assert [len(one.position_mm) for one in solve(frames, solver)] == [0] * FRAMES


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_one_and_two_particles_are_found(count: int) -> None:
    case = make_small(1, 1e-5).observation
    points = np.array([[0.3, -0.4, 0.2], [-0.8, 0.5, -0.3]])[:count]
    apart = np.linalg.norm(solve([draw(case, points)])[0].position_mm[:, None] - points, axis=2)
    assert apart.shape == (count, count)
    assert apart.min(axis=0).max() < 0.05


@pytest.mark.slow
def test_saturated_particles_are_found() -> None:
    shot = make_small(1)
    light = shot.observation.images.astype(np.float64) - 64.0
    case = with_images(shot.observation, np.minimum(64.0 + 150.0 * light, 4095.0))
    assert np.mean(case.images == 4095) > 0.1
    counts = count_found(shot, solve([case])[0])
    assert min(counts.recall, counts.precision) > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("columns", [3.0, 1000.0])
def test_a_camera_that_is_off_is_named_and_left_out(columns: float) -> None:
    shot = make_small(1)
    with pytest.warns(UserWarning, match="camera_01") as caught:
        found = solve([shifted(shot.observation, 1, columns)])[0]
    (warning,) = caught
    check_sentence(str(warning.message), "camera_01")
    counts = count_found(shot, found)
    assert min(counts.recall, counts.precision) > 0.97
    assert found.light is not None
    assert not found.light[:, 1].any()


@pytest.mark.slow
def test_cameras_that_are_swapped_among_many_are_left_out() -> None:
    shot = make_small(1, layout=(3, 3))
    with pytest.warns(UserWarning, match="camera_0") as caught:
        found = solve([swapped(shot.observation)])[0]
    assert {str(one.message)[:9] for one in caught} == {"camera_00", "camera_01"}
    counts = count_found(shot, found)
    assert min(counts.recall, counts.precision) > 0.97


@pytest.mark.slow
def test_cameras_of_which_no_three_agree_are_reported() -> None:
    """Two of four are swapped: particles that all of them see would be by chance."""
    with pytest.warns(UserWarning, match="camera_0") as caught:
        solve([swapped(make_small(1).observation)])
    for warning in caught:
        check_sentence(str(warning.message))


def streaked(case: Observation, cameras: Sequence[int], steps: int, side: int) -> Observation:
    """Blur images along a diagonal, as of particles that move while they are lit."""
    images = case.images.astype(np.float64)
    weights = np.ones(1)
    for _ in range(steps):
        weights = np.convolve(weights, [0.25, 0.5, 0.25])
    for camera in cameras:
        images[camera] = sum(
            weight * np.roll(images[camera], (step, side * step), (0, 1))
            for step, weight in zip(range(-steps, steps + 1), weights, strict=True)
        )
    return with_images(case, images)


@pytest.mark.slow
@pytest.mark.parametrize(("cameras", "side"), [([2], 1), ([0, 1, 2, 3], -1)])
def test_streaks_aslant_are_tilted_ellipses(cameras: list[int], side: int) -> None:
    shot = make_small(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = solve([streaked(shot.observation, cameras, 1, side)])[0]
    counts = count_found(shot, found)
    assert counts.recall > 0.97
    assert counts.precision > 0.97  # as of streaks along columns; a model without tilt has 0.45


@pytest.mark.slow
def test_discs_out_of_focus_are_flat() -> None:
    """Of 2.5 px radius; taken for Gaussians, a tenth of them are two and more particles."""
    steps = np.mgrid[-3:4, -3:4].reshape(2, -1).T
    steps = steps[np.hypot(*steps.T) <= 2.5]
    counts = []
    for seed in range(1, 19):  # some 40 particles each
        shot = make_small(seed, per_pixel=0.015)
        case = shot.observation
        images = np.mean([np.roll(case.images, step, (1, 2)) for step in steps], axis=0)
        noise = 2.0 * np.random.default_rng(seed).standard_normal(images.shape)
        counts.append(count_found(shot, solve([with_images(case, images + noise)])[0]))
    matched = sum(each.matched for each in counts)
    assert matched > 0.97 * sum(each.truths for each in counts)
    assert matched > 0.97 * sum(each.detections for each in counts)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
def test_long_streaks_aslant_in_a_camera_are_reported(side: int) -> None:
    with pytest.warns(UserWarning, match="camera_02") as caught:
        solve([streaked(make_small(1).observation, [2], 6, side)])
    (warning,) = caught
    check_sentence(str(warning.message), "camera_02", "+0" if side > 0 else "-0")


@pytest.mark.slow
def test_particles_outside_the_grid_are_reported() -> None:
    small = make_small(1).observation
    large = make_small(1, volume={"size_mm": [6.0, 6.0, 8.0]}).observation
    with pytest.warns(UserWarning, match="grid") as caught:
        solve([replace(large, grid=small.grid)])
    check_sentence(str(caught[0].message), "grid")


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "layout"), [(2, (3, 1)), (3, (3, 3))])
def test_right_cameras_are_not_reported(seed: int, layout: tuple[int, int]) -> None:
    shot = make_small(seed, layout=layout)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        counts = count_found(shot, solve([shot.observation])[0])
    assert counts.recall > 0.97


def solve_within(solver: str, budget_s: float | None, frames: int = 1) -> list[FoundParticles]:
    case = ImageSequence.of([make_small(6, 0.05).observation] * frames)
    algorithm = make_algorithm(solver, {} if budget_s is None else {"budget_s": budget_s})
    return list(find_in_each_frame(algorithm, solver, case, range(frames), SolverClock()))


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS[1:])
def test_a_long_budget_changes_nothing(solver: str) -> None:
    one, other = (solve_within(solver, budget, 2)[1] for budget in (None, 1e6))
    for (_, value), (_, same) in zip(one.arrays(), other.arrays(), strict=True):
        assert np.array_equal(value, same)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_budget_that_is_spent_gives_a_valid_result_quickly(solver: str) -> None:
    start = time.perf_counter()
    full = solve_within(solver, None, 3)
    between = time.perf_counter()
    found = solve_within(solver, 1e-6, 3)
    assert time.perf_counter() - between < 0.5 * (between - start)
    assert len(full[2].position_mm) > 200
    assert [len(one.position_mm) for one in found] == [0, 0, 0]


@pytest.mark.slow
def test_more_time_finds_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the search ends, the result is valid; its F1 grows with the budget."""
    shot = make_small(6, 0.05)
    scores = []
    for ticks in (2, 12, 40, 100, 100_000):
        monkeypatch.setattr("sabench.utils.threads.time.monotonic", itertools.count().__next__)
        found = solve_within("bayesian_ipr", float(ticks))[0]
        assert found.probability is not None
        scores.append(count_found(shot, found).f1)
    assert scores[-1] > 0.97
    assert scores == sorted(scores)
    assert scores[1] > 0.2
