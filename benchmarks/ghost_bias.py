"""Bias of velocities by correlated ghosts, with and without motion tracking, as Markdown tables.

    python benchmarks/ghost_bias.py [CASE ...] [--seeds N] [--record FILE]

For the cases of the suite ghost-bias (default: all) and seeds 1 to N, `piv3d` with the suite's
settings correlates pairs of volumes:

- `block_mart` and `mte_mart`: as the solvers make them.
- `no ghosts`: those of `block_mart`, dark wherever no true particle is near.
- `truth`: the synthesised field of the same particles, the limit of the correlation itself.

Ghost light is the share of a volume's intensity that is far from all true particles. Seconds are
CPU seconds of the reconstruction of a pair. The record is written after each pair, and what it
holds is not measured again.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api import ImageSequence, Reconstruction, VolumePair
from sabench.api.make import make_algorithm
from sabench.evaluation.suite_loading import load_suite
from sabench.evaluation.suites import SceneCase
from sabench.metrics.averages import finite_or_none, mean_of_each
from sabench.metrics.reconstruction_error import score_frame, true_field
from sabench.metrics.velocity_error import evaluation_lattice, sample_velocity, velocity_scores
from sabench.scenes import Scene
from sabench.simulation.in_memory import Shot, simulate_sequence
from sabench.utils.arrays import F32
from sabench.utils.confidence import mean_of
from sabench.utils.progress import progress_bar
from sabench.worlds.tracers import flow_of

RECORD = Path(__file__).with_name("records") / "ghost-bias.json"
SUITE = "ghost-bias"
CORRELATION = {"first_window": (48, 48, 32), "overlap": 0.5}  # as in the suite
NEAR = 0.05  # of a particle's peak in the synthesised field, at about two voxels from it
VARIANTS = ("truth", "no ghosts", "block_mart", "mte_mart")
_VOLUME = ("q", "peak_f1", "peak_ghost_percent")
_FIELD = ("response", "u_bias_voxel", "u_rms_voxel", "w_rms_voxel", "rms_voxel", "yield_percent")
_COLUMNS = (
    ("q", 3),
    ("ghost_light_percent", 1),
    ("peak_ghost_percent", 1),
    ("rms_voxel", 3),
    ("cpu_s", 0),
)
Figures = dict[str, float | None]
Record = dict[str, dict[str, list[Figures]]]


def measure(scene: Scene, seed: int) -> dict[str, Figures]:
    """Measure all variants of one pair."""
    shots = list(simulate_sequence(scene, seed=seed))
    frames, grid = [shot.observation for shot in shots], shots[0].observation.grid
    true = [true_field(grid, shot.particles, shot.views) for shot in shots]
    block: Any = make_algorithm("block_mart", {})
    mte: Any = make_algorithm("mte_mart", {})
    start = time.process_time()
    own = [block.solve(frame).volume for frame in frames]
    middle = time.process_time()
    sequence = ImageSequence.of(frames, scene.interval_s)
    enhanced = [one.volume for one in mte.solve(sequence)]
    end = time.process_time()
    cleared = [np.where(one > NEAR, volume, 0.0) for one, volume in zip(true, own, strict=True)]
    of = dict(zip(VARIANTS, (true, cleared, own, enhanced), strict=True))
    seconds = {"block_mart": middle - start, "mte_mart": end - middle}
    return {
        name: score_volumes(shots, true, volumes)
        | score_velocity(scene, shots, volumes)
        | {"cpu_s": seconds.get(name)}
        for name, volumes in of.items()
    }


def score_volumes(shots: Sequence[Shot], true: Sequence[F32], volumes: Sequence[F32]) -> Figures:
    """Average the figures of the two volumes."""
    rows = []
    for shot, field, volume in zip(shots, true, volumes, strict=True):
        grid = shot.observation.grid
        scores = score_frame(grid, shot.particles, shot.views, Reconstruction(volume))
        ghosts = volume[grid.scored][field[grid.scored] <= NEAR].sum(dtype=np.float64)
        share = 100.0 * float(ghosts / volume[grid.scored].sum(dtype=np.float64))
        rows.append({key: scores[key] for key in _VOLUME} | {"ghost_light_percent": share})
    return mean_of_each(rows)


def score_velocity(scene: Scene, shots: Sequence[Shot], volumes: Sequence[F32]) -> Figures:
    """Score the field of a pair as the task velocimetry does."""
    grid = shots[0].observation.grid
    pair = VolumePair(volumes[0], volumes[1], grid, scene.interval_s)
    solver: Any = make_algorithm("piv3d", dict(CORRELATION))
    field = solver.solve(pair)
    nodes, flow = evaluation_lattice(grid), flow_of(scene)
    assert flow is not None
    points = nodes.positions_mm.reshape(-1, 3)
    found, measured = sample_velocity(field, points)
    shape = nodes.velocity_mm_s.shape
    scores = velocity_scores(
        found.reshape(shape),
        flow.velocity(points, 0.0).reshape(shape),  # steady, and no particle changes its depth
        measured.reshape(shape[:3]),
        np.ones(shape[:3], dtype=np.bool_),
        nodes.step_mm,
        scene.interval_s,
        grid.voxel_mm,
    )
    return {key: finite_or_none(scores[key]) for key in _FIELD}


def text(rows: Sequence[Figures], key: str, decimals: int) -> str:
    """Write the mean over seeds of a figure with its 95 % interval."""
    mean = mean_of([value for row in rows if (value := row[key]) is not None])
    return mean.text(decimals) if mean else "-"


def responses(record: Record) -> str:
    """Write measured over true gradients as a table in Markdown."""
    lines = ["| case | seeds | truth | no ghosts | `block_mart` | `mte_mart` |"]
    lines.append("|---|---|---|---|---|---|")
    for case, of in record.items():
        cells = [text(of[name], "response", 3) for name in VARIANTS]
        lines.append(f"| {case} | {len(of['truth'])} | {' | '.join(cells)} |")
    return "\n".join(lines)


def volumes(record: Record) -> str:
    """Write the figures of volumes and the errors of velocities as a table in Markdown."""
    lines = ["| case | solver | Q | ghost light % | peak ghost % | rms voxel | CPU s |"]
    lines.append("|---|---|---|---|---|---|---|")
    for case, of in record.items():
        for name in VARIANTS[2:]:
            cells = [text(of[name], key, decimals) for key, decimals in _COLUMNS]
            lines.append(f"| {case} | `{name}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure what the record lacks and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--record", type=Path, default=RECORD)
    chosen = parser.parse_args()
    cases = load_suite(SUITE)[1]
    scenes = {case.name: case.scene for case in cases if isinstance(case, SceneCase)}
    file: Path = chosen.record
    record = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    names = chosen.cases or list(scenes)
    work = [(seed, name) for seed in range(1, chosen.seeds + 1) for name in names]
    for seed, name in progress_bar(work, "pairs"):
        of = record.setdefault(name, {variant: [] for variant in VARIANTS})
        if any(row["seed"] == seed for row in of["truth"]):
            continue
        for variant, row in measure(scenes[name], seed).items():
            of[variant].append({"seed": seed, **row})
        file.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(responses(record), volumes(record), sep="\n\n")


if __name__ == "__main__":
    main()
