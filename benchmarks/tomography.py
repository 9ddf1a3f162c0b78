"""Speed and memory of the tomographic solvers: `python benchmarks/tomography.py [solver ...]` prints JSON.

Four cameras, 700 x 700 x 140 voxels, 24,500 particles (0.05 per pixel), after Elsinga et al. (2006); then fewer voxels, fewer and more particles,
and the thesis's array of nine cameras. Five iterations each, kernels compiled before.
A visit is one voxel seen by one camera, forwards or backwards, counted from the voxels that the first guess leaves; it loads or adds to four
pixels. Shares are of the pixels that this machine can gather, measured in the same run.
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import Any

from sabench import memory
from sabench.api import Observation
from sabench.generation import simulate
from sabench.rig import load_scene
from sabench.rooflines import gathered_gigaloads_s, triad_gb_s
from sabench.scene import Scene, parse_scene
from sabench.solving import make_solver
from sabench.tomography.problem import Problem

SOLVERS = ("mlos_smart", "mlos_sart", "block_mart", "mfg_mart", "mart")
SEED = 101
ITERATIONS = 5


def variant(name: str, size_mm: list[float] | None = None, per_pixel: float | None = None) -> Scene:
    """A bundled scene with another box or density."""
    values = load_scene(name).to_dict()
    values["grid"]["crop_mm"] = [0.0, 0.0, 0.0]
    if size_mm:
        values["volume"]["size_mm"] = size_mm
    if per_pixel:
        generator, diameter = values["particles"]["generator"], values["particles"]["diameter_mm"]
        across, down, _ = (edge / voxel for edge, voxel in zip(values["volume"]["size_mm"], values["grid"]["voxel_mm"], strict=True))
        values["particles"] = {"generator": generator, "diameter_mm": diameter, "count": round(per_pixel * across * down)}
    return parse_scene(values, name)


def measured(case: Observation, solver: str, gathers: float) -> dict[str, Any]:
    """One solver on one frame."""
    made = make_solver(solver, {"iterations": ITERATIONS})
    memory.trim()
    memory.forget_peak()
    start = time.perf_counter()
    made.solve(case)
    seconds = time.perf_counter() - start
    problem = Problem.of(case, made.parameters)
    voxels = len(problem.mlos(made.parameters.threshold).lines.support)
    visits = 2.0 * ITERATIONS * voxels * len(case.cameras)
    loads = 4.0 * visits
    return {
        "s": round(seconds, 2), "peak_mb": round(memory.peak_mb() or 0.0), "lit_voxels": voxels,
        "mvoxel_cameras_per_s": round(visits / seconds / 1e6, 1), "share_of_gathers": round(loads / seconds / 1e9 / gathers, 3),
    }  # fmt: skip


def main() -> None:
    solvers = sys.argv[1:] or SOLVERS
    scenes = {
        "4 cameras, 700x700x140, .05 ppp": variant("elsinga-35x35x7"),
        "4 cameras, 700x700x70, .05 ppp": variant("elsinga-35x35x7", [35.0, 35.0, 3.5], 0.05),
        "4 cameras, 350x350x140, .05 ppp": variant("elsinga-35x35x7", [17.5, 17.5, 7.0], 0.05),
        "4 cameras, 350x350x140, .025 ppp": variant("elsinga-35x35x7", [17.5, 17.5, 7.0], 0.025),
        "4 cameras, 350x350x140, .1 ppp": variant("elsinga-35x35x7", [17.5, 17.5, 7.0], 0.1),
        "9 cameras, 1000x1000x80, .05 ppp": variant("array-9", None, 0.05),
    }
    small = simulate(variant("elsinga-35x35x7", [3.5, 3.5, 2.0], 0.02), seed=SEED).observation
    for solver in solvers:
        make_solver(solver, {}).solve(small)  # compiles
    gathers = gathered_gigaloads_s()
    report: dict[str, Any] = {"cores": os.cpu_count(), "triad_gb_per_s": round(triad_gb_s(), 1), "gathered_gigaloads_per_s": round(gathers, 2)}
    for name, scene in scenes.items():
        case = simulate(scene, seed=SEED).observation
        report[name] = {solver: measured(case, solver, gathers) for solver in solvers}
        print(name, json.dumps(report[name]), file=sys.stderr)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
