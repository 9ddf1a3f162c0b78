"""Accuracy and cost of inverse rendering, compared with the search that it starts from.

    python benchmarks/inverse_rendering.py [--seeds 1 2 3 4] [--densities 0.02 0.05 0.1]
        [--output benchmarks/records/inverse-rendering.json]

The scene is `standard-particles` with four cameras of 64 x 64 pixels and particles that are equally
bright in all of them; the splat renderer makes the images. Solvers:

    bayesian_ipr        the search
    refined             the search, and 40 more rounds of its own fit, particle by particle
    inverse_rendering   the search and the descent
    displaced           the descent alone, from particles of the search that are displaced by 0.3 px
                        along every axis and 20 % too bright or too dark (normal distributions)

Every run is the second one of the same images, so that all kernels are compiled; the CPU seconds
of all first runs together are `first_s`. Prints one line a measurement, and writes one JSON value:
recall and ghosts in percent of the true particles, the RMS distance of the pairs in the images and
in space, CPU milliseconds for each particle found, and the cost (minus the logarithm of the
probability, less that of the search).
"""

import argparse
import importlib
import json
import os
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.particle_density import cpu_s, warm_up, write_record
from sabench import plugins
from sabench.algorithms.particles import fit_cameras
from sabench.algorithms.particles.bayesian_ipr import BayesianIprSettings, search_frame
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.metrics.particle_detection import challenge_pairs, count_challenge
from sabench.scenes import Scene, parse_scene
from sabench.scenes.loading import find
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64

os.environ["SABENCH_PLUGINS"] = str(Path(__file__).parents[1] / "examples" / "plugins")
plugins.load("solvers", "inverse_rendering")
descent: Any = importlib.import_module("sabench.plugins.solvers._inverse_rendering.descent")

SIDE_PX, PIXEL_MM = 64, 0.05
DISPLACED_PX, BRIGHTER, ROUNDS = 0.3, 0.2, 40


def scene_of(per_pixel: float, side_px: int = SIDE_PX) -> Scene:
    """Make a scene of four square images, by default small ones."""
    width_mm = 4.0 * side_px / SIDE_PX
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": side_px, "columns": side_px}
    values["cameras"]["layout"] |= {"columns": 2, "rows": 2}
    values["volume"]["size_mm"] = [width_mm, width_mm, 2.5]
    values["grid"]["crop_mm"] = [0.6, 0.6, 0.1]
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    values["particles"]["per_pixel"] = per_pixel
    return parse_scene(values, f"{per_pixel:g} particles per pixel")


def search(shot: Shot) -> ParticleSearch:
    """Search for particles as `bayesian_ipr` does."""
    found = search_frame(shot.observation, fit_cameras(shot.observation), BayesianIprSettings())
    if found is None:
        raise ValueError("expected particles in the images, got none")
    return found


def move_down(found: ParticleSearch, shot: Shot) -> None:
    """Move a search's particles to the least cost."""
    model = descent.image_model(found, shot.observation, fit_cameras(shot.observation))
    descent.descend(found, model, descent.InverseRenderingSettings())


def cost_of(found: ParticleSearch) -> float:
    """Compute minus the logarithm of the probability of a search's particles."""
    logs, precision = np.log(found.light / found.typical), np.linalg.inv(found.covariance)
    squares = np.square(found.left, dtype=np.float64) / found.variance
    prior = np.einsum("ni,ij,nj->", logs, precision, logs)
    return 0.5 * float(squares[found.known].sum() + prior)


def displace(found: ParticleSearch) -> None:
    """Move particles and change their light at random."""
    rng = np.random.default_rng(7)
    step_mm = DISPLACED_PX * PIXEL_MM * rng.standard_normal(found.position.shape)
    found.position[:] = np.clip(found.position + step_mm / found.maps.half_mm, -1.0, 1.0)
    found.light *= np.exp(BRIGHTER * rng.standard_normal(found.light.shape))


def accuracy(shot: Shot, position_mm: F64) -> dict[str, Any]:
    """Score positions (n, 3) against the truth."""
    grid, true = shot.observation.grid, shot.particles.position_mm
    here, there = grid.to_voxels(position_mm), grid.to_voxels(true)
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    i, j = challenge_pairs(here, there)
    i, j = i[grid.in_scored(there[j])], j[grid.in_scored(there[j])]
    pixels = [
        camera.project(position_mm[i])[0] - camera.project(true[j])[0]
        for camera in shot.observation.cameras
    ]
    return {
        "true": counts.truths,
        "recall": round(100.0 * counts.recall, 2),
        "ghosts": round(100.0 * (counts.detections - counts.matched) / counts.truths, 2),
        "rms_px": round(rms(np.stack(pixels)), 5),
        "rms_mm": round(rms(position_mm[i] - true[j]), 6),
    }


def rms(vectors: F64) -> float:
    """Compute the root mean square length of vectors (..., k)."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=-1))))


def timed(job: Callable[[], Any]) -> tuple[Any, float]:
    """Call a job; return its result and its CPU seconds."""
    before = cpu_s()
    result = job()
    return result, cpu_s() - before


def measure(shot: Shot) -> dict[str, dict[str, Any]]:
    """Measure the search, and what fits from its particles and from displaced ones reach."""
    found, search_s = timed(lambda: search(shot))
    start, first = (found.position.copy(), found.light.copy()), cost_of(found)
    fits: dict[str, tuple[float, Callable[[], None]]] = {
        "bayesian_ipr": (search_s, lambda: None),
        "refined": (search_s, lambda: found.refine(ROUNDS)),
        "inverse_rendering": (search_s, lambda: move_down(found, shot)),
        "displaced": (0.0, lambda: move_down(found, shot)),
    }
    rows = {}
    for name, (before_s, fit) in fits.items():
        found.position[:], found.light[:] = start
        if name == "displaced":
            displace(found)
        found.subtract_all()
        start_px = accuracy(shot, points_in_mm(found.maps, found.position))["rms_px"]
        _, seconds = timed(fit)
        rows[name] = accuracy(shot, points_in_mm(found.maps, found.position)) | {
            "start_rms_px": start_px,
            "cpu_ms_particle": round(1e3 * (before_s + seconds) / len(found.position), 2),
            "cost": round(cost_of(found) - first, 2),
        }
    return rows


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--densities", type=float, nargs="+", default=[0.02, 0.05, 0.1])
    parser.add_argument("--output", type=Path)
    chosen = parser.parse_args()
    warm_up(["bayesian_ipr"])
    table: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for density in chosen.densities:
        for seed in chosen.seeds:
            shot = simulate(scene_of(density), seed=seed)
            _, first_s = timed(lambda: measure(shot))  # noqa: B023
            for name, row in measure(shot).items():
                entry = {"seed": seed, "first_s": round(first_s, 2)} | row
                table.setdefault(f"{density:g}", {}).setdefault(name, []).append(entry)
                print(f"{density:g}", name, json.dumps(entry), file=sys.stderr, flush=True)
    if chosen.output:
        write_record(chosen.output, table)


if __name__ == "__main__":
    main()
