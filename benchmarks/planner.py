"""Q, F1 and ghosts of random small scenes, beside what `sabench plan` computes of them.

    python benchmarks/planner.py measure [--scenes 140] [--output benchmarks/records/planner.json]
    python benchmarks/planner.py fit [--output benchmarks/records/planner.json]

`measure` draws scenes of 120 x 160 pixels in plain air and behind glass, with 3 to 13 cameras, 0.01
to 0.15 particles per pixel, 1.5 to 6 mm deep, and solves one frame of each by `msa`, `mlos_smart`
and `ray_triangulation`, and of every third one by `bayesian_ipr`. What the record holds of other
numbers stays. The first 120 scenes are fitted; the others test the fit. `fit` prints the
coefficients for `sabench/evaluation/planning/expected_scores.json` and the errors on the scenes
that were left out.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.particle_scores import find_particles, score_particles  # noqa: E402
from sabench.api.make import make_algorithm, make_solver  # noqa: E402
from sabench.evaluation.planning.plan import plan  # noqa: E402
from sabench.metrics.reconstruction_error import score_frame  # noqa: E402
from sabench.scenes import Scene, build_rig, parse_scene  # noqa: E402
from sabench.scenes.bundled import find  # noqa: E402
from sabench.simulation.in_memory import simulate  # noqa: E402

RECORD = ROOT / "benchmarks/records/planner.json"
FITTED = 120  # scenes of the fit; the others test it
VOLUMES = ("msa", "mlos_smart")
PARTICLES = {"ray_triangulation": 1, "bayesian_ipr": 3}  # solved in every nth scene
_PIXEL_MM = 0.05
_DISTANCE_MM = 510.0
_ENERGY = 100.0


def draw_scene(number: int) -> Scene:
    """Draw the scene of a number."""
    rng = np.random.default_rng([23, number])
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    depth, tangent = rng.uniform(1.5, 6.0), rng.uniform(0.2, 0.55)
    margin = round(0.3 + 0.5 * depth * tangent, 2)
    values["title"] = f"planner {number}"
    values["volume"]["size_mm"] = [160 * _PIXEL_MM, 120 * _PIXEL_MM, depth]
    values["grid"] = {
        "voxel_mm": [_PIXEL_MM, _PIXEL_MM, rng.uniform(0.05, 0.15)],
        "crop_mm": [margin, margin, 0.0],
    }
    values["cameras"] |= {
        "rows": 120,
        "columns": 160,
        "f_number": rng.uniform(12.0, 32.0),
        "layout": _draw_layout(rng, tangent * _DISTANCE_MM),
    }
    if rng.random() < 0.5:
        del values["wall"]
        values["cameras"]["center_mm"] = [0.0, 0.0, -_DISTANCE_MM]
    if rng.random() < 0.4:
        values["illumination"]["scattering"] = "isotropic"
    values["particles"]["per_pixel"] = float(np.exp(rng.uniform(np.log(0.01), np.log(0.15))))
    if rng.random() < 0.6:
        values["calibration"] = {"shift_px": rng.uniform(0.0, 0.6)}
    return _expose(values, float(np.exp(rng.uniform(np.log(80.0), np.log(6000.0)))))


def _draw_layout(rng: np.random.Generator, reach_mm: float) -> dict[str, Any]:
    """Draw an array whose outer cameras are so far from its middle."""
    columns, rows = [(0, 3), (2, 2), (0, 5), (3, 2), (0, 8), (3, 3), (4, 3), (1, 13)][
        rng.integers(8)
    ]
    if columns == 0:
        return {"kind": "ring", "count": rows, "radius_mm": reach_mm, "start_deg": 17.0}
    if columns == 1:
        return {"kind": "cross", "arm": 3, "spacing_mm": reach_mm / 3.0}
    spacing = 2.0 * reach_mm / np.hypot(columns - 1, rows - 1)
    return {"kind": "grid", "columns": columns, "rows": rows, "spacing_mm": [spacing, spacing]}


def _expose(values: dict[str, Any], electrons: float) -> Scene:
    """Set the energy that gives a median particle's brightest pixel so many electrons."""
    values["illumination"]["pulse_energy_mj"] = _ENERGY
    got = figures_of(parse_scene(values, "planner"))["peak_e"]
    values["illumination"]["pulse_energy_mj"] = _ENERGY * electrons / got
    return parse_scene(values, "planner")


def figures_of(scene: Scene) -> dict[str, float]:
    """Return all figures of a scene's plan."""
    figures = plan(scene).to_dict()["figures"]
    return {key: one["value"] for key, one in figures.items() if one["value"] is not None}


def measure(scene: Scene, number: int) -> dict[str, Any]:
    """Solve one frame by all solvers."""
    shot, grid = simulate(scene, seed=number), build_rig(scene).grid
    figures: dict[str, Any] = {}
    for name in VOLUMES:
        estimate = make_solver(name, {}).solve(shot.observation)
        scores = score_frame(grid, shot.particles, shot.views, estimate)
        kept = {"q": "q", "ghosts": "peak_ghost_percent", "f1": "peak_f1"}
        figures[name] = {key: scores[score] for key, score in kept.items()}
    cameras = build_rig(scene).cameras
    for name, every in PARTICLES.items():
        if number % every:
            continue
        found = find_particles(make_algorithm(name, {}), shot.observation)
        scores = score_particles(found, shot, cameras, None)
        figures[name] = {key: scores[key] for key in ("f1", "ghosts", "true")}
    return figures


def main() -> None:
    """Measure scenes, or fit what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("measure", "fit"))
    parser.add_argument("--scenes", type=int, default=FITTED + 20)
    parser.add_argument("--output", type=Path, default=RECORD)
    chosen = parser.parse_args()
    record = json.loads(chosen.output.read_text()) if chosen.output.exists() else {}
    for number in range(chosen.scenes):
        if str(number) in record:
            continue
        scene = draw_scene(number)
        record[str(number)] = {"plan": figures_of(scene), "scores": measure(scene, number)}
        chosen.output.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        used = resource.getrusage(resource.RUSAGE_SELF)
        print(number, record[str(number)]["scores"], f"{used.ru_utime:.0f} s", flush=True)


if __name__ == "__main__":
    main()
