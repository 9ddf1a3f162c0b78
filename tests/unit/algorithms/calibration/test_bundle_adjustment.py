"""Bundle adjustment: derivatives, exactness, the Cramer-Rao bound, outliers and anchors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sabench.algorithms.calibration import bundle_adjustment, kernels
from sabench.algorithms.calibration.cramer_rao import compute_bound
from sabench.algorithms.calibration.joint_fit import adjust
from sabench.algorithms.calibration.normal_equations import spreads
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.algorithms.calibration.problem import CalibrationProblem, make_anchors
from sabench.geometry.rigid_motion import RigidMotion, fit_lateral_motion, rotation_matrices
from sabench.utils.arrays import F64
from tests.helpers.calibration_cases import (
    board_images,
    calibration_scene,
    case_of,
    misses,
    true_error_px,
)

ALL = FreeParameters(True, ("k1", "k2", "p1", "p2", "k3"), (0, 1, 2), (0,), tilt=True)
NOISELESS = {"detection": None, "calibration": {"points": 0.0}}


def truth(**changes: Any) -> tuple[WallFrame, State, bundle_adjustment.BoardImages]:
    case, cameras, points, exact = case_of(calibration_scene(**(NOISELESS | changes)))
    frame = WallFrame.from_cameras(cameras, points)
    return frame, frame.state(case.target.points_mm, points), board_images(case, exact)


def noisy(
    seen: bundle_adjustment.BoardImages, sigma_px: float, rng: np.random.Generator
) -> bundle_adjustment.BoardImages:
    return replace(seen, pixels=seen.pixels + rng.normal(0.0, sigma_px, seen.pixels.shape))


def mean_px(state: State, seen: bundle_adjustment.BoardImages) -> float:
    return float(np.linalg.norm(misses(state, seen), axis=-1).mean())


BENT = {"distortion": {"k1": -0.4, "k2": 3.0, "k3": 20.0, "p1": 4e-3, "p2": -3e-3}}
ASLANT = [{"camera": f"camera_0{n}", "tilt_deg": [9.0 - n, 3.0 * n]} for n in range(8)]


LEANING = {"normal": [0.04, -0.05, 1.0], "point_mm": [3.0, 4.0, 1.0]}


@pytest.mark.parametrize(
    "changes", [{"wall": None}, {"wall": LEANING}, {"cameras": BENT | {"each": ASLANT}}]
)
def test_the_kernel_projects_as_cameras_do(changes: dict[str, object]) -> None:
    """One unknown in the rarest medium by numpy, and the bundle's own in the wall's frame."""
    _, state, seen = truth(**changes)
    errors = misses(state, seen)
    assert len(errors) > 4000
    assert np.abs(errors).max() < 1e-9


def observe(
    state: State, seen: bundle_adjustment.BoardImages, place: tuple[int, int, int], row: F64
) -> F64:
    """Project a point (camera, board, point), and fill in the derivatives."""
    c, k, i = place
    arm = state.board_rotations[k] @ seen.board[i]
    camera = state.rotations[c], state.centers[c], state.lenses[c]
    media, at = (state.indices, state.thicknesses), state.board_positions[k]
    u, v, ok = kernels.observe(*camera, media, arm, at, row, np.zeros((3, 3)))
    assert ok
    return np.array([u, v])


COLUMNS = kernels.CAMERA + kernels.BOARD + 4


def test_all_derivatives_are_those_of_finite_differences() -> None:
    _, state, seen = truth()
    bend = np.random.default_rng(3).normal(0.0, 0.02, (9, 7))
    state = replace(state, lenses=state.lenses + np.pad(bend, ((0, 0), (3, 0))))
    exact, numeric, room = np.zeros((3, 2, COLUMNS))
    observe(state, seen, (3, 2, 17), exact)
    for column, unit in enumerate(1e-6 * np.eye(COLUMNS)):
        ends = []
        for step in (unit, -unit):
            cameras, boards = np.zeros((9, kernels.CAMERA)), np.zeros((5, 6))
            cameras[3], boards[2], shared = np.split(step, [kernels.CAMERA, COLUMNS - 4])
            there = state.apply_steps(cameras, shared, boards, ALL)
            ends.append(observe(there, seen, (3, 2, 17), room))
        numeric[:, column] = (ends[0] - ends[1]) / 2e-6
    assert_allclose(exact, numeric, rtol=1e-6, atol=2e-6)  # rounding of 500 px over a step of 1e-6


def dense_jacobian(
    state: State, seen: bundle_adjustment.BoardImages, free: FreeParameters
) -> tuple[F64, list[list[int]]]:
    """Derivatives (n, 2, unknowns) of all pixels seen, and the camera, board and point of each."""
    own, shared = free.columns(3)
    boards, count = kernels.BOARD, 9 * len(own) + len(shared)
    jacobian, places = [], np.argwhere(seen.weights > 0.0).tolist()
    row = np.zeros((2, COLUMNS))
    for c, k, i in places:
        observe(state, seen, (c, k, i), row)
        full, start = np.zeros((2, count + 5 * boards)), count + k * boards
        full[:, c * len(own) : (c + 1) * len(own)] = row[:, own]
        full[:, 9 * len(own) : count] = row[:, kernels.CAMERA + boards + shared]
        full[:, start : start + boards] = row[:, kernels.CAMERA : kernels.CAMERA + boards]
        jacobian.append(full)
    return np.stack(jacobian), places


def test_the_equations_are_those_of_a_dense_jacobian() -> None:
    _, state, seen = truth()
    seen = noisy(seen, 0.5, np.random.default_rng(0))
    free = FreeParameters(True, ("k1",), (2,), (0,))
    normal = bundle_adjustment.normal_equations(state, seen, free)
    own, shared = free.columns(3)
    jacobian, places = dense_jacobian(state, seen, free)
    errors = bundle_adjustment.residuals(state, seen)
    dense = jacobian.reshape(-1, jacobian.shape[2])
    right = np.concatenate([errors[c, k, i] for c, k, i in places])
    whole, split = dense.T @ dense, 9 * len(own) + len(shared)
    assert_allclose(normal.aa, whole[:split, :split], rtol=1e-9, atol=1e-6)
    for k in range(5):
        part = slice(split + k * kernels.BOARD, split + (k + 1) * kernels.BOARD)
        assert_allclose(normal.ab[k], whole[:split, part], rtol=1e-9, atol=1e-6)
        assert_allclose(normal.bb[k], whole[part, part], rtol=1e-9, atol=1e-6)
    expected = dense.T @ right
    assert_allclose(np.concatenate([normal.a, normal.d.ravel()]), expected, rtol=1e-7, atol=1e-5)
    assert normal.cost == pytest.approx(right @ right)


def test_covariances_of_pixels_are_those_of_a_dense_jacobian() -> None:
    _, state, seen = truth()
    free = FreeParameters(True, ("k1", "p2"), (2,), (0,))
    jacobian, places = dense_jacobian(state, seen, free)
    root = np.random.default_rng(2).normal(0.0, 1e-3, 2 * (jacobian.shape[2],))
    images, columns = (seen.pixels, seen.weights), free.columns(3)
    found = spreads(state.array(), state.boards(seen.board), images, columns, root @ root.T)
    there = jacobian @ root
    expected = np.einsum("nax,nbx->nab", there, there)[:, [0, 1, 0], [0, 1, 1]]
    assert_allclose(found[tuple(np.transpose(places))], expected, rtol=1e-7, atol=1e-9)
    assert np.isnan(found[seen.weights == 0.0]).all()


@pytest.mark.slow
def test_the_kernel_of_covariances_reads_and_writes_nothing_beyond_its_arrays() -> None:
    """As plain Python, which refuses an index beyond an array, with all of the wall unknown."""
    _, state, seen = truth()
    free = (np.arange(kernels.CAMERA), np.arange(2 * len(state.indices) - 2))
    size = 9 * len(free[0]) + len(free[1]) + kernels.BOARD * len(state.board_positions)
    root = np.random.default_rng(3).normal(0.0, 1e-3, (size, 2))
    images = seen.pixels[:, :, :2], seen.weights[:, :, :2]
    given = state.array(), state.boards(seen.board[:2]), images, free, root @ root.T
    assert_allclose(spreads.py_func(*given), spreads(*given), rtol=1e-9)


@pytest.mark.parametrize("moving", ["cameras", "boards"])
def test_one_half_is_found_while_the_other_stays(moving: bundle_adjustment.Moving) -> None:
    _, state, seen = truth()
    rng, free, boards = np.random.default_rng(5), FreeParameters(), moving == "boards"
    own, shared = free.columns(3)
    off = 1e-3 * rng.normal(size=(9, len(own))), 1e-3 * rng.normal(size=(5, kernels.BOARD))
    wrong = state.apply_steps(
        0.0 * off[0] if boards else off[0], np.zeros(len(shared)), off[1] * boards, free
    )
    assert np.nanmax(np.abs(misses(wrong, seen))) > 0.1
    found = bundle_adjustment.refine(wrong, seen, free, moving=moving).state
    assert np.nanmax(np.abs(misses(found, seen))) < 1e-4
    assert_allclose(found.centers, state.centers, atol=1e-3)
    still = "centers" if boards else "board_positions"
    assert_array_equal(getattr(found, still), getattr(state, still))


@pytest.mark.parametrize(("cameras", "blank"), [(3, True), (13, False)])
def test_exact_points_give_exact_cameras_from_any_start(cameras: int, blank: bool) -> None:
    centers = [(x, y) for y in (-150.0, 0.0, 150.0) for x in (-150.0, 0.0, 150.0)]
    centers += [(-300.0, 0.0), (300.0, 0.0), (0.0, -300.0), (0.0, 300.0)]
    chosen = [3, 4, 8] if cameras == 3 else range(cameras)
    places = [{"center_mm": [*centers[number], -490.0]} for number in chosen]
    rough = {"center_mm": 58.0, "turn_deg": 5.8, "focal_percent": 11.0, "known": []}
    rough |= {"points": 0.0 if blank else 0.3, "blank": blank}
    layout = {"layout": {"kind": "list", "places": places}}
    scene = calibration_scene(detection=None, calibration=rough, cameras=layout)
    case, _, points, exact = case_of(scene)
    problem = CalibrationProblem.from_case(case, FreeParameters())
    fit = bundle_adjustment.refine(problem.start, problem.seen, FreeParameters())
    answer: Any = problem.answer(problem.align_to_nominal(fit.state))
    found = answer.points_mm
    assert true_error_px(answer.cameras, found, exact) < 1e-5
    motion = fit_lateral_motion(found.reshape(-1, 3), points.reshape(-1, 3))
    assert np.abs(motion(found) - points).max() < 1e-3


@pytest.mark.slow
def test_noise_comes_out_at_the_bound() -> None:
    """Of the true reprojection error, the points' scatter and mean depth, in sixteen draws."""
    _, state, seen = truth()
    free, noise, rng = FreeParameters(), 0.5, np.random.default_rng(5)
    bound = compute_bound(state, seen, free, noise)
    true, scatter, depth = [], [], []
    points = state.points(seen.board).reshape(-1, 3)
    for _ in range(16):
        fit = bundle_adjustment.refine(state, noisy(seen, noise, rng), free)
        assert fit.converged
        true.append(mean_px(fit.state, seen))
        found = fit.state.points(seen.board).reshape(-1, 3)
        errors = fit_lateral_motion(found, points)(found) - points
        scatter.append(errors.std(axis=0))
        depth.append(errors[:, 2].mean())
    assert np.mean(true) == pytest.approx(bound.reprojection_px, rel=0.05)
    assert_allclose(np.sqrt(np.mean(np.square(scatter), axis=0)), bound.point_std_mm, rtol=0.35)
    assert 0.5 < np.std(depth) / bound.point_mean_mm[2] < 1.6
    assert bound.unknowns == 9 * 7 + 5 * 6 - 3


def test_the_measured_error_tells_the_true_one() -> None:
    """True over measured is sqrt(p / (N - p)) for p unknowns and N equations."""
    _, state, seen = truth()
    rng = np.random.default_rng(8)
    bound, ratios = compute_bound(state, seen, FreeParameters(), 0.3), []
    for _ in range(6):
        measured = noisy(seen, 0.3, rng)
        found = bundle_adjustment.refine(state, measured, FreeParameters()).state
        ratios.append(mean_px(found, seen) / mean_px(found, measured))
    assert np.mean(ratios) == pytest.approx(bound.efficiency, rel=0.06)


@pytest.mark.slow
def test_outliers_are_found_and_left_out() -> None:
    _, state, seen = truth()
    rng = np.random.default_rng(2)
    wrong = rng.random(seen.weights.shape) < 0.3
    pixels = noisy(seen, 0.1, rng).pixels
    pixels = pixels + wrong[..., None] * rng.normal(0.0, 20.0, pixels.shape)
    found = adjust(state, replace(seen, pixels=pixels), FreeParameters())
    assert mean_px(found.fit.state, seen) < 0.02
    assert found.noise_px == pytest.approx(0.1, rel=0.1)
    far = wrong & (np.linalg.norm(pixels - seen.pixels, axis=-1) > 1.0)
    assert not (found.used & far).any()
    assert (found.used & ~wrong).sum() > 0.99 * (~wrong & (seen.weights > 0.0)).sum()


def test_an_anchor_settles_the_depth() -> None:
    """One known point determines the absolute depth. Images through a plane wall hardly do."""
    errors = []
    for known in ([], [{"frame": 2, "point": 60, "axes": "z", "sigma_mm": 0.05}]):
        calibration = {"points": 0.02, "known": known}
        scene = calibration_scene(detection={"noise_px": 2.0}, calibration=calibration)
        case, _, points, _ = case_of(scene, 4)
        problem = CalibrationProblem.from_case(case, FreeParameters())
        first = adjust(problem.start, problem.seen, FreeParameters())
        anchors = make_anchors(case, problem.frame, first.noise_px)
        found = adjust(first.fit.state, replace(problem.seen, anchors=anchors), FreeParameters())
        off = problem.frame.points(found.fit.state, problem.seen.board) - points
        errors.append(abs(float(off[..., 2].mean())))
    assert errors[0] > 0.3
    assert errors[1] < 0.2


def test_what_a_wall_does_not_notice_changes_no_image() -> None:
    _, state, seen = truth()
    turn = rotation_matrices(np.array([0.0, 0.0, 0.3]))
    moved = state.move(RigidMotion(turn, np.array([5.0, -7.0, 0.0])))
    assert np.nanmax(np.abs(misses(moved, seen))) < 1e-9
    sunk = state.move(RigidMotion(np.eye(3), np.array([0.0, 0.0, 1.0])))
    assert np.nanmax(np.abs(misses(sunk, seen))) > 1e-3
