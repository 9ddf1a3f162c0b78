"""Particles found and ghosts over the particle density, by particle solvers.

    python benchmarks/particle_density.py [--seeds 1 2] [--cases NAME ...] [--solvers NAME ...]
        [--output benchmarks/records/particle-density.json]

The scene is `standard-particles`: 240 x 320 pixels behind glass, particles of the whole volume,
scored where all cameras see. Cases:

    equal 0.05 ... 0.15     four cameras, each particle equally bright in all of them
    equal 0.20              the same with nine cameras
    off 0.10                four cameras, each off by 0.1 px
    own 0.01                nine cameras, Mie scattering of single particles, noise of the scene
    own 0.05                four cameras, the same with light from a direction in which no two
                            cameras see the same angle
    hard                    the standard suite's hard case of tracking, one frame

The splat renderer makes the images. Its model differs from that of `bayesian_ipr`: widths come from
the lens and the particles' size and vary over the field and with depth, particles differ in size by
10 %, and grey values are noisy and rounded. The seeds are others than those on which the solver's
settings were chosen (101). Prints one line a measurement, and writes one JSON value: recall and
ghosts in percent of the true particles, F1, the RMS distance in the images, and CPU seconds. What
the file holds of other cases and solvers stays.
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

from sabench.api import Camera, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.metrics.particle_detection import challenge_pairs, count_challenge
from sabench.scenes import Scene, parse_scene
from sabench.scenes.bundled import find
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64

_EQUAL = {"scattering": "isotropic", "pulse_energy_mj": 6.5}  # light of the scene's Mie particles
_FOUR = {"columns": 2, "rows": 2}
_OBLIQUE = {"direction": [0.8, 0.6, 0.0]}
CASES: dict[str, tuple[float, dict[str, Any], dict[str, Any], float]] = {
    # particles per pixel, illumination, layout, shift of the cameras in px
    "equal 0.05": (0.05, _EQUAL, _FOUR, 0.0),
    "equal 0.10": (0.10, _EQUAL, _FOUR, 0.0),
    "equal 0.15": (0.15, _EQUAL, _FOUR, 0.0),
    "equal 0.20": (0.20, _EQUAL, {}, 0.0),
    "off 0.10": (0.10, _EQUAL, _FOUR, 0.1),
    "own 0.01": (0.01, {}, {}, 0.0),
    "own 0.05": (0.05, _OBLIQUE, _FOUR, 0.0),
    "hard": (0.04, {"pulse_energy_mj": 75.0}, _FOUR, 0.3),
}
SOLVERS = ("bayesian_ipr", "ipr", "openlpt", "optv")


def scene_of(case: str) -> Scene:
    """Change the standard scene to a case."""
    per_pixel, illumination, layout, shift_px = CASES[case]
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["particles"]["per_pixel"] = per_pixel
    values["illumination"] |= illumination
    values["cameras"]["layout"] |= layout
    if shift_px:
        values["calibration"] = {"shift_px": shift_px}
    return parse_scene(values, case)


def cpu_s() -> float:
    """Read the CPU seconds of this process and its children."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)


def measure(name: str, shot: Shot, true_cameras: tuple[Camera, ...]) -> dict[str, Any]:
    """Run a solver on a shot and score it; the CPU seconds include no compilation."""
    case = shot.observation
    solver: Any = make_algorithm(name, {})
    why = solver.skip(ImageSequence.of([case]))
    if why:
        return {"skipped": why}
    before = cpu_s()
    found: F64 = solver.solve(ImageSequence.of([case]))[0].position_mm
    seconds = cpu_s() - before
    grid, true = case.grid, shot.particles.position_mm
    here, there = grid.to_voxels(found), grid.to_voxels(true)
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    i, j = challenge_pairs(here, there)
    i, j = i[grid.in_scored(there[j])], j[grid.in_scored(there[j])]
    apart = [
        np.linalg.norm(camera.project(found[i])[0] - camera.project(true[j])[0], axis=1)
        for camera in true_cameras
    ]
    return {
        "recall": round(100.0 * counts.recall, 2),
        "ghosts": round(100.0 * (counts.detections - counts.matched) / counts.truths, 2),
        "f1": round(counts.f1, 4),
        "rms_px": round(float(np.sqrt(np.mean(np.square(apart)))), 4) if len(i) else None,
        "true": counts.truths,
        "cpu_s": round(seconds, 1),
    }


def warm_up(names: list[str]) -> None:
    """Compile the kernels on a few particles."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 60, "columns": 80}
    values["cameras"]["layout"] |= _FOUR
    values["volume"]["size_mm"] = [4.0, 3.0, 2.0]
    values["grid"]["crop_mm"] = [0.2, 0.2, 0.0]
    shot = simulate(parse_scene(values, "warm-up"), seed=1)
    for name in names:
        solver: Any = make_algorithm(name, {})
        solver.solve(ImageSequence.of([shot.observation]))


def exact_cameras(case: str, shot: Shot) -> tuple[Camera, ...]:
    """Make the cameras without their error of calibration."""
    if not CASES[case][3]:
        return _plain(shot.observation)
    per_pixel, illumination, layout, _ = CASES[case]
    CASES["exact"] = (per_pixel, illumination, layout, 0.0)
    return _plain(simulate(scene_of("exact"), seed=1).observation)


def _plain(case: Observation) -> tuple[Camera, ...]:
    return tuple(camera for camera in case.cameras if isinstance(camera, Camera))


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS))
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    table: dict[str, dict[str, list[dict[str, Any]]]] = {}
    warm_up(chosen.solvers)
    for case in chosen.cases:
        for seed in chosen.seeds:
            shot = simulate(scene_of(case), seed=seed)
            cameras = exact_cameras(case, shot)
            for name in chosen.solvers:
                row = measure(name, shot, cameras)
                table.setdefault(case, {}).setdefault(name, []).append({"seed": seed} | row)
                print(case, name, json.dumps({"seed": seed} | row), file=sys.stderr, flush=True)
    if chosen.output:
        write_record(chosen.output, table)


def write_record(path: Path, table: dict[str, dict[str, list[dict[str, Any]]]]) -> None:
    """Write what was measured; other cases and solvers of the file stay as they are."""
    record = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for case, rows in table.items():
        record[case] = record.get(case, {}) | rows
    path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
