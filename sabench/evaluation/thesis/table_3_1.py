"""Table 3.1: operations and seconds of six algorithms.

Operations are by the thesis's formulas, with its numbers and with ours.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from sabench.algorithms.tomography.problem import TomographyProblem
from sabench.api import Observation, Solver
from sabench.api.make import make_solver
from sabench.evaluation.thesis.common import Row, cases, coarsen, make_row, simulate_frame
from sabench.evaluation.thesis.theory import TABLE_3_1, Algorithm, Setup, operations
from sabench.scenes import Scene

SEEDS = 5
_CASES: Mapping[Algorithm, str] = {
    "asa": "9-cameras",
    "msa": "9-cameras",
    "mart": "4-cameras",
    "mfg-mart": "4-cameras",
    "mlos-sart": "4-cameras",
    "mlos-smart": "4-cameras",
}
_STATED: Mapping[Algorithm, float] = {
    "asa": 8.81e9,
    "msa": 9.11e9,
    "mart": 2.15e11,
    "mfg-mart": 8.00e10,
    "mlos-sart": 1.81e10,
    "mlos-smart": 1.81e10,
}
_FEWER: Mapping[Algorithm, float] = {
    "mart": 16.3,
    "mfg-mart": 6.1,
    "mlos-sart": 1.4,
    "mlos-smart": 1.4,
}  # over MSA's operations: section 3.3.1
_WARM_PX = 50


def rows(seeds: Sequence[int], pixels: int | None) -> Iterator[Row]:
    """Measure three rows for every algorithm, then the thesis's claims on ratios."""
    scenes = {case.name: coarsen(case.scene, pixels) for case in cases("table-3-1")}
    seconds: dict[Algorithm, list[float]] = {}
    for algorithm, name in _CASES.items():
        formula = sum(operations(algorithm, TABLE_3_1[algorithm]))
        yield make_row(
            f"{algorithm}: operations, the thesis's counts", _STATED[algorithm], [formula]
        )
        frames = [simulate_frame(scenes[name], seed).observation for seed in seeds]
        setups = [_setup(algorithm, frame) for frame in frames]
        yield make_row(
            f"{algorithm}: operations, our counts",
            None,
            [sum(operations(algorithm, setup)) for setup in setups],
            _describe(setups[0]),
        )
        seconds[algorithm] = _time_frames(algorithm, scenes[name], frames)
        yield make_row(f"{algorithm}: seconds", None, seconds[algorithm])
    for algorithm, fewer in _FEWER.items():
        ratios = [
            slow / fast for slow, fast in zip(seconds[algorithm], seconds["msa"], strict=True)
        ]
        yield make_row(
            f"{algorithm}: seconds over those of msa",
            fewer,
            ratios,
            "the thesis's is of operations",
            "smaller",
        )


def _setup(algorithm: Algorithm, frame: Observation) -> Setup:
    """Count what a solver visits of this frame, as the thesis's formulas do."""
    cameras, voxels = len(frame.cameras), float(np.prod(frame.grid.shape))
    if algorithm in ("asa", "msa"):
        return Setup(cameras, voxels)
    chosen = _solver(algorithm).parameters
    problem = TomographyProblem.from_case(frame, chosen)
    start = problem.mfg if algorithm == "mfg-mart" else problem.mlos
    lit_voxels = float(len(start(chosen.threshold).lines.support))
    lit_pixels = float((problem.measured.light >= chosen.threshold).sum()) / cameras
    return Setup(
        cameras,
        voxels,
        lit_voxels,
        lit_voxels,
        lit_voxels / max(lit_pixels, 1.0),
        chosen.iterations,
    )


def _describe(setup: Setup) -> str:
    illuminated = (
        f", {setup.lit_voxels:.3g} of them lit, {setup.path_voxels:.3g} on a line of sight"
        f", {setup.iterations} iterations"
        if setup.iterations
        else ""
    )
    return f"{setup.cameras} cameras, {setup.voxels:.3g} voxels{illuminated}"


def _solver(algorithm: Algorithm) -> Solver:
    return make_solver(algorithm.replace("-", "_"), {})


def _time_frames(algorithm: Algorithm, scene: Scene, frames: Sequence[Observation]) -> list[float]:
    """Measure the seconds of each frame; a small one compiles the kernels before."""
    solver = _solver(algorithm)
    solver.solve(simulate_frame(coarsen(scene, _WARM_PX), 1).observation)
    seconds = []
    for frame in frames:
        start = time.perf_counter()
        solver.solve(frame)
        seconds.append(time.perf_counter() - start)
    return seconds
