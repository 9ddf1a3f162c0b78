"""Scores of every solver on images with hot pixels, glints and a reflection.

    python benchmarks/flawed_images.py [--quick] [--seeds N] [--solvers NAME ...] [--out FILE]

The scene is a part of `standard-particles`: nine cameras of 120 x 160 pixels, 0.05 particles per
pixel; OpenPTV takes four of them, and the particle solvers 0.02 per pixel. Flaws are added to the
finished images:

    one       a full-well pixel in one camera
    each      a full-well pixel in every camera
    all       in every camera, one pixel of a thousand at full well, four glints and a saturated
              reflection of a wall

Prints one JSON value: Q of volumes and F1 of particles for each solver, over all true particles
(`q`, `f1`) and without those that a glint or the reflection covers in any camera (`q_open`,
`f1_open`; the clean images are scored without them, too). `--quick` takes a smaller part.
"""

import argparse
import functools
import json
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from sabench.api import ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.metrics.quality_factor import quality
from sabench.metrics.reconstruction_error import true_field
from sabench.scenes import Scene, parse_scene
from sabench.scenes.loading import find
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F32, F64, Bool

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.helpers.flawed_images import add_flaws, covered_by

VOLUMES = (
    "asa",
    "msa",
    "map_shift_average",
    "mart",
    "mfg_mart",
    "block_mart",
    "smart",
    "mlos_smart",
    "mlos_sart",
)
PARTICLES = ("bayesian_ipr", "ray_triangulation", "openlpt", "optv")
_FLAWS = ("clean", "one", "each", "all")
_RADIUS_PX = 1.0  # of a found particle about a true one, in the mean image
_AROUND_VOXELS = 6.0  # a covered particle's surroundings, in which voxels do not count
_REACH_PX = 3  # of a particle's image


def part_of_standard(quick: bool, per_pixel: float, cameras: int) -> Scene:
    """Cut the standard scene to fewer pixels and less volume."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    rows, columns = (72, 96) if quick else (120, 160)
    values["cameras"] |= {"rows": rows, "columns": columns}
    values["volume"]["size_mm"] = [0.05 * columns, 0.05 * rows, 5.0 if quick else 10.0]
    values["grid"]["crop_mm"] = [0.8, 0.6, 0.0]
    values["particles"]["per_pixel"] = per_pixel
    if cameras == 4:
        values["cameras"]["layout"] |= {"columns": 2, "rows": 2}
    return parse_scene(values, "part of standard-particles")


def score_volume(shot: Shot, volume: F32, covered: Bool) -> tuple[float, float]:
    """Compute Q over the scored grid, and without the surroundings of covered particles."""
    grid = shot.observation.grid
    true = true_field(grid, shot.particles, shot.views)
    hidden = np.zeros(grid.shape, dtype=bool)
    near = grid.to_voxels(shot.particles.position_mm[covered])
    if len(near):
        z, y, x = np.indices(grid.shape).reshape(3, -1)
        away, _ = cKDTree(near).query(np.stack([x, y, z], 1), distance_upper_bound=_AROUND_VOXELS)
        hidden = np.isfinite(away).reshape(grid.shape)
    whole = quality(volume[grid.scored], true[grid.scored])
    open_ = [np.where(hidden, np.float32(0.0), one)[grid.scored] for one in (volume, true)]
    return whole, quality(*open_)


def score_particles(
    shot: Shot, found_mm: F64, covered: Bool, hidden: Callable[[F64], Bool]
) -> tuple[float, float]:
    """Compute F1 of particles, and without the true and the found ones that are covered."""
    grid = shot.observation.grid
    true, found = grid.to_voxels(shot.particles.position_mm), grid.to_voxels(found_mm)
    here, there = grid.in_scored(true), grid.in_scored(found)
    whole = _f1(true[here], found[there])
    return whole, _f1(true[here & ~covered], found[there & ~hidden(found_mm)])


def _f1(true: F64, found: F64) -> float:
    return 2.0 * len(_pair(true, found)) / max(1, len(true) + len(found))


def _pair(true: F64, found: F64) -> list[tuple[int, int]]:
    """Pair true and found particles one to one, the nearest first."""
    near = cKDTree(true).sparse_distance_matrix(
        cKDTree(found), _RADIUS_PX, output_type="coo_matrix"
    )
    out: list[tuple[int, int]] = []
    left, right = set(range(len(true))), set(range(len(found)))
    for k in np.argsort(near.data):
        i, j = int(near.row[k]), int(near.col[k])
        if i in left and j in right:
            left.remove(i)
            right.remove(j)
            out.append((i, j))
    return out


def measure(name: str, shot: Shot, case: Observation, seed: int) -> dict[str, float | str]:
    """Run a solver on a case and score its estimate."""
    solver: Any = make_algorithm(name, {})
    hidden = functools.partial(is_covered, shot, seed)
    covered = hidden(shot.particles.position_mm)
    try:
        if name in VOLUMES:
            scores = score_volume(shot, solver.solve(case).volume, covered)
        else:
            found = next(iter(solver.solve(ImageSequence.of([case])))).position_mm
            scores = score_particles(shot, found, covered, hidden)
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}"[:200]}
    kind = "q" if name in VOLUMES else "f1"
    return {kind: round(scores[0], 4), f"{kind}_open": round(scores[1], 4)}


def is_covered(shot: Shot, seed: int, positions_mm: F64) -> Bool:
    """Mark positions (n, 3) whose image a glint or the reflection reaches in any camera."""
    seen = shot.observation
    covered = np.zeros(len(positions_mm), dtype=bool)
    for camera, area in zip(seen.cameras, covered_by(seen, seed), strict=True):
        wide = binary_dilation(area, iterations=_REACH_PX)
        pixels, valid = camera.project(positions_mm)
        column, row = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(int).T
        inside = valid & (row >= 0) & (column >= 0)
        inside &= (row < wide.shape[0]) & (column < wide.shape[1])
        covered[inside] |= wide[row[inside], column[inside]]
    return covered


def cases_of(shot: Shot, seed: int) -> Iterator[tuple[str, Observation]]:
    """Make the cases of one shot."""
    seen = shot.observation
    for kind in _FLAWS:
        yield kind, replace(seen, images=add_flaws(seen, kind, seed))


def run(quick: bool, seeds: int, names: list[str]) -> dict[str, Any]:
    """Measure solvers on all cases; scores are means over the seeds."""
    table: dict[str, Any] = {}
    for name in names:
        density = 0.05 if name in VOLUMES else 0.02
        scene = part_of_standard(quick, density, 4 if name == "optv" else 9)
        rows: dict[str, list[dict[str, Any]]] = {}
        for seed in range(1, seeds + 1):
            shot = simulate(scene, seed=seed)
            for kind, case in cases_of(shot, seed):
                rows.setdefault(kind, []).append(measure(name, shot, case, seed))
        table[name] = {kind: _mean(one) for kind, one in rows.items()}
        print(name, json.dumps(table[name]), file=sys.stderr, flush=True)
    return table


def _mean(rows: list[dict[str, Any]]) -> dict[str, Any]:
    failed = next((row for row in rows if "error" in row), None)
    if failed:
        return failed
    return {key: round(float(np.mean([row[key] for row in rows])), 4) for key in rows[0]}


def main() -> None:
    """Print the table, or write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--solvers", nargs="+", default=[*VOLUMES, *PARTICLES])
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    text = json.dumps(run(chosen.quick, chosen.seeds, chosen.solvers), indent=1)
    if chosen.out:
        chosen.out.write_text(text + "\n", encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
