"""Accuracy and speed of the joint refractive calibration.

`NUMBA_NUM_THREADS=1 python benchmarks/calibration.py [draws]` prints JSON.

Accuracy is a ratio to the Cramer-Rao bound of the same data: mean true reprojection error, and
scatter of the points along each axis, over as many draws of noise and boards as asked for. Times
are medians after a first run. They are compared with the time that a dense product of as many rows
and columns as one step's normal equations takes in the same run.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import (
    BoardImages,
    normal_equations,
    refine,
    residuals,
)
from sabench.algorithms.calibration.cramer_rao import compute_bound
from sabench.algorithms.calibration.joint_fit import adjust
from sabench.algorithms.calibration.parameters import FreeParameters, State, WallFrame
from sabench.algorithms.calibration.problem import CalibrationProblem
from sabench.geometry.rigid_motion import fit_lateral_motion
from sabench.scenes import build_rig, parse_scene
from sabench.utils.arrays import F64
from sabench.utils.progress import progress_bar
from sabench.worlds.calibration_targets import exact_pixels, pose_target

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from reproduction.chapter_4 import (
    D_PIX,
    Board,
    board,
    draw,
    places_of,
    reprojection,
    scene_of,
    solve_case,
)

_NOISES = (0.1, 0.5, 1.0, 2.0)
_CAMERAS = (3, 7, 9, 13)
_LENSES = ("principal_point", "k1")
_STARTS = (0.001, 0.01, 0.1, 0.2, 0.3)


def median_s(work: Callable[[], object], repeats: int = 15) -> float:
    """Measure the median time of several runs after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def truth_of(given: Board) -> tuple[WallFrame, State, BoardImages]:
    """Compute the true state and exact images of a draw."""
    frame = WallFrame.from_cameras(given.cameras, given.points_mm)
    board_mm = given.case.target.points_mm
    weights = np.asarray(np.isfinite(given.exact).all(axis=-1), dtype=np.float64)
    return (
        frame,
        frame.state(board_mm, given.points_mm),
        BoardImages(board_mm, np.nan_to_num(given.exact), weights),
    )


def ratios(cameras: int, noise: float, draws: int, unknown: tuple[str, ...] = ()) -> dict[str, Any]:
    """Measure errors relative to their bounds.

    The ratio of true to measured error is relative to its own bound. `unknown` names the lens
    parameters that are unknown besides focal lengths.
    """
    free = FreeParameters.from_names(unknown)
    found: dict[str, list[Any]] = {
        "reprojection": [],
        "scatter": [],
        "efficiency": [],
        "depth": [],
        "steps": [],
    }
    for seed in range(1, draws + 1):
        _, state, seen = truth_of(board.__wrapped__(cameras, 0.3, 0.0, 0.0, seed))
        bound = compute_bound(state, seen, free, noise)
        rng = np.random.default_rng(seed)
        noisy = replace(seen, pixels=seen.pixels + noise * rng.standard_normal(seen.pixels.shape))
        fit = refine(state, noisy, free)
        there = seen.weights > 0.0
        true, measured = (
            float(np.linalg.norm(residuals(fit.state, one)[there], axis=-1).mean())
            for one in (seen, noisy)
        )
        points = state.points(seen.board).reshape(-1, 3)
        made = fit.state.points(seen.board).reshape(-1, 3)
        errors = fit_lateral_motion(made, points)(made) - points
        found["reprojection"].append(true / bound.reprojection_px)
        found["scatter"].append(errors.std(axis=0) / bound.point_std_mm)
        found["efficiency"].append(true / measured / bound.efficiency)
        found["depth"].append(errors[:, 2].mean() / bound.point_mean_mm[2])
        found["steps"].append(fit.steps)
    return {
        "cameras": cameras,
        "noise_px": noise,
        "unknown": list(unknown),
        "draws": draws,
        "true_over_bound": round(float(np.mean(found["reprojection"])), 4),
        "std_over_bound_xyz": np.mean(found["scatter"], axis=0).round(4).tolist(),
        "rms_std_over_bound_xyz": np.sqrt(np.mean(np.square(found["scatter"]), axis=0))
        .round(4)
        .tolist(),
        "true_over_measured_over_expected": round(float(np.mean(found["efficiency"])), 4),
        "depth_std_over_bound": round(float(np.std(found["depth"])), 3),
        "steps": float(np.mean(found["steps"])),
    }


def starts(cameras: int, noise: float, seeds: int) -> list[dict[str, Any]]:
    """Compare the results of initial guesses with that of the true state.

    Returns the largest difference in true error, px, and how many draws ended in the same minimum.
    """
    rows = []
    for start in _STARTS:
        differences = []
        for seed in range(1, seeds + 1):
            given = board.__wrapped__(cameras, 0.3, noise, start, seed)
            _, state, seen = truth_of(given)
            problem = CalibrationProblem.from_case(given.case, FreeParameters())
            best = refine(state, problem.seen, FreeParameters())
            fit = refine(problem.start, problem.seen, FreeParameters())
            there = seen.weights > 0.0
            both = [
                float(np.linalg.norm(residuals(one.state, seen)[there], axis=-1).mean())
                for one in (best, fit)
            ]
            differences.append(abs(both[1] - both[0]))
        rows.append(
            {
                "cameras": cameras,
                "noise_px": noise,
                "start": start,
                "largest_difference_px": max(differences),
                "draws": seeds,
            }
        )
    return rows


def measure_anchored(noise: float, draws: int) -> dict[str, Any]:
    """Measure the mean depth of all boards with one point known to 0.05 mm.

    There are nine cameras.
    """
    depths = []
    for seed in range(1, draws + 1):
        given = draw(scene_of(9, 0.3, noise, 0.1), seed)
        answer = solve_case("refractive_autocal", given)
        depths.append(float((places_of(answer, given) - given.points_mm)[..., 2].mean()))
    rms = float(np.sqrt(np.mean(np.square(depths))))
    return {
        "noise_px": noise,
        "draws": draws,
        "rms_mean_depth_mm": round(rms, 4),
        "rms_in_pixels_of_the_middle": round(rms / D_PIX, 3),
    }


def with_outliers(share: float, draws: int) -> dict[str, Any]:
    """Measure the true error where a fraction of the points is 20 px off.

    The others are 0.1 px off; nine cameras, from an initial guess of 0.1.
    """
    values = scene_of(9, 0.3, 0.1, 0.1).to_dict()
    values["detection"] |= {"outliers": share}
    errors = []
    for seed in range(1, draws + 1):
        given = draw(parse_scene(values, "outliers"), seed)
        answer = solve_case("refractive_autocal", given)
        errors.append(float(np.nanmean(reprojection(answer, given, given.exact))))
    return {
        "outliers": share,
        "draws": draws,
        "true_px": round(float(np.mean(errors)), 4),
        "largest_px": round(max(errors), 4),
    }


def measure_time(cameras: int, frames: int) -> dict[str, Any]:
    """Measure median seconds of a calibration, and of the parts of a step."""
    values = scene_of(cameras, 0.3, 0.1, 0.1).to_dict() | {"frames": frames}
    scene = parse_scene(values, "timed")
    rig, placed = build_rig(scene), pose_target(scene, 1)
    exact = np.stack([exact_pixels(camera, placed.points_mm) for camera in rig.cameras])
    rng = np.random.default_rng(1)
    weights = np.asarray(np.isfinite(exact).all(axis=-1), dtype=np.float64)
    seen = BoardImages(
        placed.target.points_mm,
        np.nan_to_num(exact) + 0.1 * rng.standard_normal(exact.shape),
        weights,
    )
    initial = placed.points_mm + 5.0 * rng.standard_normal(placed.points_mm.shape)
    start = WallFrame.from_cameras(rig.cameras, initial).state(placed.target.points_mm, initial)
    fit = adjust(start, seen, FreeParameters()).fit
    step = median_s(lambda: normal_equations(start, seen, FreeParameters()))
    count, local = float(seen.weights.sum()), 13
    product = dense_product_s(int(count), local)
    return {
        "cameras": cameras,
        "frames": frames,
        "points": int(count),
        "steps": fit.steps,
        "seconds": round(median_s(lambda: adjust(start, seen, FreeParameters())), 4),
        "equations_s": round(step, 5),
        "points_per_s": round(count / step),
        "equations_over_dense_product": round(step / product, 2),
    }


def dense_product_s(points: int, unknowns: int) -> float:
    """Time J^T J of as many rows and columns as one step sums up, by BLAS."""
    jacobian: F64 = np.random.default_rng(0).standard_normal((2 * points, unknowns))
    return median_s(lambda: jacobian.T @ jacobian)


def main() -> None:
    """Print times, ratios and bounds of calibrations as JSON."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    pairs = [(cameras, noise) for cameras in _CAMERAS for noise in _NOISES]
    report = {
        "times": [measure_time(9, 5), measure_time(13, 20)],
        "lenses": [
            ratios(cameras, noise, draws, _LENSES)
            for cameras, noise in progress_bar(pairs, "draws with unknown lenses")
        ],
        "bound": [ratios(cameras, noise, draws) for cameras, noise in progress_bar(pairs, "draws")],
        "anchor": [
            measure_anchored(noise, max(4, 2 * draws // 5))
            for noise in progress_bar((0.1, 2.0), "anchors")
        ],
        "outliers": with_outliers(0.3, max(4, draws // 5)),
        "starts": [
            row
            for cameras in progress_bar(_CAMERAS, "starts")
            for row in starts(cameras, 0.1, max(5, draws // 10))
        ],
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
