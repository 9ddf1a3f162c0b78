"""Particles found over time by trackers, frame by frame.

    python benchmarks/particle_tracking.py [--seeds 1] [--cases NAME ...] [--solvers NAME ...]
        [--frames 12] [--output benchmarks/records/particle-tracking.json]

The scene is `particle-tracking`: 240 x 240 pixels behind glass, four cameras, turbulence with
displacements of 3 px rms per frame, particles of the whole volume, scored where all cameras see.
Cases:

    equal 0.05 ... 0.20     each particle equally bright in all cameras
    dim 0.20                less light, so that no pixel saturates
    own 0.05                Mie scattering of single particles, light from a direction in which no
                            two cameras see the same angle

The splat renderer makes the images; its model differs from those of the solvers, as
`benchmarks/particle_density.py` says. Settings were chosen on seed 101. Recall and ghosts are
percent of the true particles. Prints one line a measurement, and writes one JSON value: for each
solver and frame recall, ghosts and the RMS distance in the images; scores of trajectories over all
frames; CPU seconds per frame. What the file holds of other cases and solvers stays.
"""

import argparse
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.particle_density import cpu_s, warm_up, write_record  # noqa: E402
from sabench.api import Camera, FoundParticles, ImageSequence  # noqa: E402
from sabench.api.make import make_algorithm  # noqa: E402
from sabench.metrics.particle_detection import challenge_pairs, count_challenge  # noqa: E402
from sabench.metrics.trajectories import link_scores  # noqa: E402
from sabench.scenes import Scene, parse_scene  # noqa: E402
from sabench.scenes.loading import find  # noqa: E402
from sabench.simulation.in_memory import Shot, simulate_sequence  # noqa: E402
from sabench.utils.arrays import F64, I64, Bool  # noqa: E402

_EQUAL = {"scattering": "isotropic", "pulse_energy_mj": 6.5}  # light of the scene's Mie particles
_DIM = _EQUAL | {"pulse_energy_mj": 2.5}  # as an experimenter sets it: no pixel saturates
_OBLIQUE = {"direction": [0.8, 0.6, 0.0]}
CASES: dict[str, tuple[float, dict[str, Any]]] = {
    "equal 0.05": (0.05, _EQUAL),
    "equal 0.10": (0.10, _EQUAL),
    "equal 0.15": (0.15, _EQUAL),
    "equal 0.20": (0.20, _EQUAL),
    "dim 0.20": (0.20, _DIM),
    "own 0.05": (0.05, _OBLIQUE),
}
SOLVERS = ("shake_the_box", "openlpt", "optv")


def scene_of(case: str, frames: int) -> Scene:
    """Change the tracking scene to a case."""
    per_pixel, illumination = CASES[case]
    values = tomllib.loads(find("particle-tracking", "scenes").read_text(encoding="utf-8"))
    values["frames"] = frames
    values["particles"]["per_pixel"] = per_pixel
    values["illumination"] |= illumination
    return parse_scene(values, case)


def measure(name: str, shots: list[Shot], interval_s: float) -> dict[str, Any]:
    """Run a solver on a sequence and score it; the CPU seconds include no compilation."""
    sequence = ImageSequence.of([shot.observation for shot in shots], interval_s)
    solver: Any = make_algorithm(name, {})
    why = solver.skip(sequence)
    if why:
        return {"skipped": why}
    before = cpu_s()
    found: list[FoundParticles] = list(solver.solve(sequence))
    spent = (cpu_s() - before) / len(shots)
    frames = [score_frame(shot, one) for shot, one in zip(shots, found, strict=True)]
    return {"frames": frames, "cpu_s": round(spent, 2)} | over_time(shots, found, interval_s)


def score_frame(shot: Shot, found: FoundParticles) -> dict[str, Any]:
    """Score one frame."""
    here, there, i, j = _pair(shot, found)
    grid = shot.observation.grid
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    one, other = found.position_mm[i], shot.particles.position_mm[j]
    cameras = [camera for camera in shot.observation.cameras if isinstance(camera, Camera)]
    apart = [camera.project(one)[0] - camera.project(other)[0] for camera in cameras]
    squares = np.sum(np.square(apart), axis=2)
    return {
        "recall": round(100.0 * counts.recall, 2),
        "ghosts": round(100.0 * (counts.detections - counts.matched) / counts.truths, 2),
        "rms_px": round(float(np.sqrt(squares.mean())), 4) if len(i) else None,
        "true": counts.truths,
    }


def _pair(shot: Shot, found: FoundParticles) -> tuple[F64, F64, I64, I64]:
    """Return voxels of found and true particles, and pairs whose truth is in the scored part."""
    grid = shot.observation.grid
    here, there = grid.to_voxels(found.position_mm), grid.to_voxels(shot.particles.position_mm)
    i, j = challenge_pairs(here, there)
    scored = grid.in_scored(there[j])
    return here, there, i[scored], j[scored]


def over_time(
    shots: list[Shot], found: list[FoundParticles], interval_s: float
) -> dict[str, float | None]:
    """Score the trajectories, if there are any."""
    if any(one.trajectory is None for one in found):
        return {}
    rows = [_scored_rows(shot, one) for shot, one in zip(shots, found, strict=True)]
    scores = link_scores(
        [one.position_mm[kept] for one, (kept, *_) in zip(found, rows, strict=True)],
        [np.asarray(one.trajectory)[kept] for one, (kept, *_) in zip(found, rows, strict=True)],
        [shot.particles.position_mm[true] for shot, (_, true, _) in zip(shots, rows, strict=True)],
        [shot.particles.id[true] for shot, (_, true, _) in zip(shots, rows, strict=True)],
        [pairs for *_, pairs in rows],
        [interval_s * number for number in range(len(shots))],
        [range(len(shots))],
    )
    return {key: round(value, 4) if np.isfinite(value) else None for key, value in scores.items()}


def _scored_rows(shot: Shot, found: FoundParticles) -> tuple[Bool, Bool, tuple[I64, I64]]:
    """Mark scored particles, found and true, and pair them, as the task `particles` does."""
    here, there, i, j = _pair(shot, found)
    grid = shot.observation.grid
    kept, true = grid.in_scored(here), grid.in_scored(there)
    kept[i] = True
    return kept, true, ((np.cumsum(kept) - 1)[i], (np.cumsum(true) - 1)[j])


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS))
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    warm_up(chosen.solvers)
    table: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for case in chosen.cases:
        scene = scene_of(case, chosen.frames)
        interval_s = 1.0 / scene.timing.rate_hz if scene.timing else 1.0
        for seed in chosen.seeds:
            shots = list(simulate_sequence(scene, seed=seed))
            for name in chosen.solvers:
                row = measure(name, shots, interval_s)
                table.setdefault(case, {}).setdefault(name, []).append({"seed": seed} | row)
                print(f"{case:12s} seed {seed} {name:14s} {_line(row)}", flush=True)
        if chosen.output:
            write_record(chosen.output, table)  # after each case: the next may be stopped


def _line(row: dict[str, Any]) -> str:
    """Format the last frame's scores, and those of trajectories."""
    if "skipped" in row:
        return f"skipped: {row['skipped']}"
    rest = {key: value for key, value in row.items() if key != "frames"}
    return f"{row['frames'][-1]} {rest}"


if __name__ == "__main__":
    main()
