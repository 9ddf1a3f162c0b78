"""Cost of particle solvers: per particle over the density, beside OpenLPT, and at full size.

    python benchmarks/particle_speed.py [--parts density peer large] [--seed 1]
        [--output benchmarks/records/particle-speed.json]

Parts:

    density     `bayesian_ipr` on one instant at 0.02 and 0.125 particles per pixel, 4 cameras: CPU
                time per particle found, and their ratio
    peer        `bayesian_ipr` and OpenLPT on one instant, `shake_the_box` and OpenLPT on twelve
                frames, 0.05 particles per pixel, one after the other: CPU time per particle found
    large       125,000 particles, 13 cameras of 1000 x 1000 pixels, four frames of a shear flow:
                time by the clock and CPU time of each frame, of which the last starts from
                predictions, and the largest memory of the process

Scenes and light are those of `particle_density.py` and `particle_tracking.py`. Prints a JSON value
for each part. What the file holds of other parts stays.
"""

import argparse
import itertools
import json
import resource
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks import particle_density, particle_tracking  # noqa: E402
from benchmarks.particle_density import cpu_s, warm_up  # noqa: E402
from sabench.api import ImageSequence, Observation  # noqa: E402
from sabench.api.make import make_algorithm  # noqa: E402
from sabench.scenes import Scene, parse_scene  # noqa: E402
from sabench.scenes.loading import find  # noqa: E402
from sabench.simulation.in_memory import simulate, simulate_sequence  # noqa: E402

PARTS = ("density", "peer", "large")
_LARGE_FRAMES = 4


def per_particle_ms(name: str, case: str, seed: int) -> float:
    """Measure the CPU milliseconds per particle found in one instant."""
    shot = simulate(particle_density.scene_of(case), seed=seed)
    row = particle_density.measure(name, shot, particle_density.exact_cameras(case, shot))
    return float(round(1e3 * row["cpu_s"] / (0.01 * row["recall"] * row["true"]), 3))


def measure_density(seed: int) -> dict[str, Any]:
    """Compare the cost per particle at two densities."""
    thin, dense = (per_particle_ms("bayesian_ipr", f"equal {one}", seed) for one in (0.02, 0.125))
    return {"ms at 0.02": thin, "ms at 0.125": dense, "ratio": round(dense / thin, 2)}


def measure_peer(seed: int) -> dict[str, Any]:
    """Compare the cost per particle found with OpenLPT's."""
    row: dict[str, Any] = {
        f"instant, {name}": per_particle_ms(name, "equal 0.05", seed)
        for name in ("bayesian_ipr", "openlpt")
    }
    scene = particle_tracking.scene_of("equal 0.05", 12)
    assert scene.timing is not None
    shots, interval_s = list(simulate_sequence(scene, seed=seed)), 1.0 / scene.timing.rate_hz
    for name in ("shake_the_box", "openlpt"):
        one = particle_tracking.measure(name, shots, interval_s)
        found = sum(0.01 * frame["recall"] * frame["true"] for frame in one["frames"])
        row[f"over time, {name}"] = round(1e3 * one["cpu_s"] * len(shots) / found, 3)
    return row


def large_scene() -> Scene:
    """Make 13 cameras of 1000 x 1000 pixels, and frames of a shear flow of 1 to 2 px a frame."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 1000, "columns": 1000}
    values["cameras"]["layout"] = particle_density.THIRTEEN
    values["volume"]["size_mm"] = [50.0, 50.0, 10.0]
    values["grid"]["crop_mm"] = [4.0, 4.0, 0.0]
    values["particles"]["per_pixel"] = 0.125
    values["illumination"] |= particle_density.EQUAL
    values["frames"], values["timing"] = _LARGE_FRAMES, {"rate_hz": 100.0}
    gradient = [[0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.1, 0.0, 0.0]]
    shear = {"velocity_mm_s": [6.0, 4.0, 2.0], "gradient_1_s": gradient}
    values["flow"] = {"generator": "linear_flow"} | shear
    return parse_scene(values, "large")


def measure_large(seed: int) -> dict[str, Any]:
    """Time the first frame and the last, which starts from predictions."""
    shots = list(simulate_sequence(large_scene(), seed=seed))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    begun: dict[int, tuple[float, float]] = {}

    def load(frame: int) -> Observation:
        begun[frame] = time.perf_counter(), cpu_s()  # of the last call: cameras are fitted first
        return shots[frame].observation

    first = shots[0].observation
    times = tuple(0.01 * frame for frame in range(len(shots)))
    sequence = ImageSequence(first.cameras, first.grid, times, load)
    solver: Any = make_algorithm("shake_the_box", {})
    found = list(solver.solve(sequence))
    begun[len(shots)] = time.perf_counter(), cpu_s()
    marks = [begun[frame] for frame in range(len(shots) + 1)]
    spent = [(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(marks)]
    return {
        "particles": len(shots[0].particles.position_mm),
        "s": [round(one, 1) for one, _ in spent],
        "cpu_s": [round(one, 1) for _, one in spent],
        "gb before": round(before, 1),
        "peak gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1),
        "frames": [
            particle_tracking.score_frame(shot, one) for shot, one in zip(shots, found, strict=True)
        ],
    }


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=PARTS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    warm_up(["bayesian_ipr", "shake_the_box"])
    measures = {"density": measure_density, "peer": measure_peer, "large": measure_large}
    for part in chosen.parts:
        row = {"seed": chosen.seed} | measures[part](chosen.seed)
        print(part, json.dumps(row), flush=True)
        if chosen.output:
            path: Path = chosen.output
            old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
            path.write_text(json.dumps(old | {part: row}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
