"""Speed of tomography: `python benchmarks/tomography.py [WIDTH DEPTH PPP]`.

Four cameras 27 degrees off the axis look at WIDTH x WIDTH x DEPTH voxels of a pixel's size (700 x
700 x 140: the volume of Elsinga et al. 2006) with PPP particles per pixel (0.05) of the volume's
face. Everything is compiled on a small volume first. Rates are compared with what the machine can
do, measured in the same run: a projection or back-projection reads or writes four pixels for every
voxel and camera, so its roofline is a fourth of the rate of random reads from an image; the
bandwidth is that of a + b c over large arrays. The quality of the solvers' defaults is
measured on a smaller volume of the same array. Prints JSON.
"""

import functools
import json
import math
import os
import sys
import timeit
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from sabench import plugins
from sabench.algorithms.tomography.problem import SparseParameters, TomographyProblem
from sabench.api import Observation
from sabench.api.make import make_solver
from sabench.metrics.reconstruction_error import score_frame
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.in_memory import simulate
from sabench.utils.confidence import mean_of
from sabench.utils.memory import forget_peak, peak_mb
from sabench.utils.progress import progress_bar

ITERATIONS = 5
_JUDGED = ("mart", "block_mart", "mlos_smart")
SOLVERS = ("mlos_sart", "mlos_smart", "block_mart", "mart", "mfg_mart", "smart")
TILT_DEG, VOXEL_MM, DISTANCE_MM = 27.0, 0.05, 510.0


def scene_of(width: int, depth: int, ppp: float, cameras: int = 4) -> Scene:
    """Make a ring of cameras in air, whose images hold the whole volume."""
    size = [width * VOXEL_MM, width * VOXEL_MM, depth * VOXEL_MM]
    pixels = math.ceil((1.1 * width + 0.6 * depth) / 8) * 8
    tilt = math.radians(TILT_DEG)
    layout = {
        "kind": "ring",
        "count": cameras,
        "radius_mm": DISTANCE_MM * math.sin(tilt),
        "start_deg": 45.0,
    }
    values: dict[str, Any] = load_scene("quick").to_dict() | {
        "volume": {"center_mm": [0.0, 0.0, 0.0], "size_mm": size},
        "grid": {"voxel_mm": [VOXEL_MM] * 3},
        "particles": {
            "generator": "uniform",
            "count": max(1, round(ppp * width * width)),
            "diameter_mm": 0.02,
        },
        "sensor": {"full_well_e": 1e7, "gain_dn_e": 0.2, "bit_depth": 16, "shot_noise": False},
    }
    del values["wall"]
    values["cameras"] |= {
        "rows": pixels,
        "columns": pixels,
        "particle_sigma_px": 0.85,
        "layout": layout,
    }
    values["cameras"]["center_mm"] = [0.0, 0.0, -DISTANCE_MM * math.cos(tilt)]
    values["illumination"] |= {
        "scattering": "isotropic",
        "pulse_energy_mj": 10.0,
        "thickness_mm": 2.0 * size[2],
        "height_mm": 2.0 * size[1],
    }
    return parse_scene(values, "benchmark")


def fastest(work: Callable[[], object], repeats: int = 3) -> float:
    """Measure the seconds of the fastest of several runs, after one to warm up."""
    work()
    return min(timeit.repeat(work, number=1, repeat=repeats))


@numba.njit(parallel=True)
def triad(a: Any, b: Any, c: Any) -> None:
    """Compute a = b + 3 c, the STREAM triad."""
    for i in numba.prange(len(a)):
        a[i] = b[i] + np.float32(3.0) * c[i]


@numba.njit(parallel=True, fastmath=True)
def read_at(values: Any, positions: Any) -> float:
    """Sum values at scattered positions."""
    total = 0.0
    for i in numba.prange(len(positions)):
        total += values[positions[i]]
    return total


def machine(pixels: int) -> dict[str, float]:
    """Measure bandwidth, GB/s, and random reads from an image, millions/s."""
    a, b, c = (np.ones(30_000_000, dtype=np.float32) for _ in range(3))
    positions = np.random.default_rng(0).integers(pixels, size=10_000_000, dtype=np.uint32)
    image = np.ones(pixels, dtype=np.float32)
    return {
        "triad_gb_per_s": 3.0 * a.nbytes / 1e9 / fastest(lambda: triad(a, b, c)),
        "random_reads_millions_per_s": len(positions)
        / 1e6
        / fastest(lambda: read_at(image, positions)),
    }


def operator_rates(case: Observation, reads: float) -> dict[str, float]:
    """Measure first guess, projection and back-projection.

    Speeds are in millions of voxels times cameras per second; the latter two are compared with the
    roofline.
    """
    parameters = SparseParameters()
    problem = TomographyProblem.from_case(case, parameters)
    state = problem.mlos(parameters.threshold)
    lines, images = state.lines, problem.measured.light
    pairs, most = len(state.values) * len(case.cameras) / 1e6, lines.support.shape
    rates = {
        "first_guess": math.prod(most)
        * len(case.cameras)
        / 1e6
        / fastest(lambda: problem.mlos(parameters.threshold)),
        "forward": pairs / fastest(lambda: lines.forward(state.values)),
        "adjoint": pairs / fastest(lambda: lines.adjoint(images)),
    }
    against = {
        f"{name}_against_reads": rates[name] * 4.0 / reads for name in ("forward", "adjoint")
    }
    return {
        "nonzero_millions": len(state.values) / 1e6,
        "nonzero_share": len(state.values) / math.prod(most),
        **rates,
        **against,
    }


def measure_time(name: str, case: Observation, bandwidth: float) -> dict[str, float | None]:
    """Run a solver once.

    Its rate counts all voxels, and is compared with reading the volume once per camera and
    iteration.
    """
    solver = plugins.load("solvers", name)
    work = functools.partial(solver(solver.Parameters(iterations=ITERATIONS)).solve, case)
    forget_peak()
    seconds = timeit.timeit(work, number=1)
    steps = math.prod(case.grid.shape) * len(case.cameras) * ITERATIONS
    return {
        "seconds": seconds,
        "mvoxel_cameras_per_s": steps / 1e6 / seconds,
        "against_bandwidth": 4.0 * steps / 1e9 / bandwidth / seconds,
        "peak_mb": peak_mb(),
    }


def round_all(value: Any) -> Any:
    """Round all floats of nested dictionaries to four digits."""
    if isinstance(value, dict):
        return {key: round_all(inner) for key, inner in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def accuracy(ppp: float) -> dict[str, Any]:
    """Measure Q and particles detected as peaks on 300 x 300 x 100 voxels.

    Solvers have their defaults. Figures are means over seeds 1 to 5, with 95 % intervals of Q.
    """
    scores: dict[str, list[Any]] = {name: [] for name in _JUDGED}
    for seed in progress_bar(range(1, 6), f"accuracy at {ppp:g} ppp"):
        shot = simulate(scene_of(300, 100, ppp), seed=seed)
        for name, own in scores.items():
            guess = make_solver(name, {}).solve(shot.observation)
            own.append(score_frame(shot.observation.grid, shot.particles, shot.views, guess))
    return {name: _summary(own) for name, own in scores.items()}


def _summary(scores: list[Any]) -> dict[str, Any]:
    q = mean_of([score["q"] for score in scores])
    means = {
        key: float(np.mean([score[key] for score in scores]))
        for key in ("peak_true_percent", "peak_ghost_percent")
    }
    return means | ({"q": q.mean, "ci95": q.half_width} if q else {})


def main() -> None:
    """Print times and memory of the tomographic solvers as JSON."""
    width, depth, ppp = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    warm = simulate(scene_of(48, 16, 0.02), seed=100).observation
    for name in progress_bar(SOLVERS, "compile"):
        measure_time(name, warm, 1.0)
    case = simulate(scene_of(width, depth, ppp), seed=100).observation
    limits = machine(case.images[0].size)
    bandwidth, reads = limits["triad_gb_per_s"], limits["random_reads_millions_per_s"]
    scaling: dict[str, dict[str, Scene]] = {
        "cameras": {str(n): scene_of(width, depth, ppp, n) for n in (3, 4, 6, 9)},
        "depth": {str(n): scene_of(width, n, ppp) for n in (depth // 4, depth // 2, depth)},
        "ppp": {str(n): scene_of(width, depth, n) for n in (ppp / 2.0, ppp, 2.0 * ppp)},
    }
    report = {
        "cores": os.cpu_count(),
        "threads": numba.get_num_threads(),
        "cameras": len(case.cameras),
        "images": case.images.shape[1:],
        "grid_zyx": case.grid.shape,
        "ppp": ppp,
        "iterations": ITERATIONS,
        "machine": limits,
        "solvers": {name: measure_time(name, case, bandwidth) for name in SOLVERS},
        "operator": operator_rates(case, reads),
        "accuracy_300x300x100": {str(own): accuracy(own) for own in (0.05, 0.1)},
        "mlos_smart_against": {
            kind: {
                n: measure_time("mlos_smart", simulate(scene, seed=100).observation, bandwidth)
                for n, scene in cases.items()
            }
            for kind, cases in scaling.items()
        },
    }
    print(json.dumps(round_all(report), indent=2))


if __name__ == "__main__":
    sys.argv += ["700", "140", "0.05"][len(sys.argv) - 1 :]
    main()
