"""Q, F1 and ghosts of random small scenes, and the planner's model fitted to them.

    python benchmarks/planner.py measure [--scenes 700] [--output benchmarks/records/planner.json]
    python benchmarks/planner.py figures [--output benchmarks/records/planner.json]
    python benchmarks/planner.py fit [--output benchmarks/records/planner.json]

`measure` draws scenes of 120 x 160 pixels in plain air and behind glass, with 3 to 25 cameras, 0.01
to 0.15 particles per pixel, 1.5 to 12 mm deep, and solves them by `msa`, `mlos_smart` and
`ray_triangulation`, and every third one by `bayesian_ipr`. Volumes are scored in several draws of
particles, noise and calibration errors, eight in the first 280 scenes and three in the others: Q
and F1 are means, ghosts geometric means, because those of `msa` differ by factors between draws.
What the record holds of other numbers stays. `figures` computes the figures of all its scenes
again, for a model of other figures. `fit` fits all scenes but numbers 220 to 279, writes
`sabench/apps/planning/expected_scores.json`, and prints the errors on 240 to 279. The 20
before them guided the choice of the model, and count for neither.
"""

import argparse
import json
import resource
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.particle_scores import find_particles, score_particles  # noqa: E402
from sabench.api.make import make_algorithm, make_solver  # noqa: E402
from sabench.api.solvers import Solver  # noqa: E402
from sabench.apps.planning import expected_scores as model  # noqa: E402
from sabench.apps.planning.expected_scores import GaussianProcess, Kernel  # noqa: E402
from sabench.apps.planning.plan import plan  # noqa: E402
from sabench.metrics.reconstruction_error import score_frame  # noqa: E402
from sabench.scenes import Scene, build_rig, parse_scene  # noqa: E402
from sabench.scenes.loading import find  # noqa: E402
from sabench.simulation.in_memory import Shot, simulate  # noqa: E402
from sabench.utils.arrays import F64  # noqa: E402

RECORD = ROOT / "benchmarks/records/planner.json"
# scenes that are not fitted, of which the latter test the model
NOT_FITTED, TESTED = range(220, 280), range(240, 280)
VOLUMES = ("msa", "mlos_smart")
PARTICLES = {"ray_triangulation": 1, "bayesian_ipr": 3}  # solved in every nth scene
_DRAWS, _FEWER = 8, 3  # of volumes; fewer after the scenes that test the model
_PIXEL_MM = 0.05
_DISTANCE_MM = 510.0
_ENERGY = 100.0
_SOME_GHOSTS = 0.05  # per true particle: fewer are a handful in a scene of this size
_RING, _CROSS = 0, 1  # in place of a number of columns
_LAYOUTS = [
    *((_RING, 3), (2, 2), (_RING, 5), (3, 2), (_RING, 8)),
    *((3, 3), (4, 3), (_CROSS, 13), (4, 4), (5, 5)),
]


def draw_scene(number: int) -> Scene:
    """Draw the scene of a number."""
    rng = np.random.default_rng([23, number])
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    depth = float(np.exp(rng.uniform(np.log(1.5), np.log(12.0))))
    tangent = rng.uniform(0.2, min(0.55, 3.8 / depth))  # the views meet over half of the width
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
    columns, rows = _LAYOUTS[rng.integers(len(_LAYOUTS))]
    if columns == _RING:
        return {"kind": "ring", "count": rows, "radius_mm": reach_mm, "start_deg": 17.0}
    if columns == _CROSS:
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
    """Return all figures of a scene's plan but expected scores: the model may need new figures."""
    with patch("sabench.apps.planning.plan.plan_scores", return_value=None):
        figures = plan(scene).to_dict()["figures"]
    return {key: one["value"] for key, one in figures.items() if one["value"] is not None}


def _features(scene: Scene) -> list[float]:
    return _rounded(model.features_of(figures_of(scene)))


def measure(scene: Scene, number: int) -> dict[str, Any]:
    """Score volumes of several draws, and particles of the first one."""
    draws = _DRAWS if number < TESTED.stop else _FEWER
    shots = [simulate(scene, seed=number + 1000 * draw) for draw in range(draws)]
    figures: dict[str, Any] = {
        name: _together([_score_volume(make_solver(name, {}), scene, shot) for shot in shots])
        for name in VOLUMES
    }
    cameras = build_rig(scene).cameras
    for name, every in PARTICLES.items():
        if number % every == 0:
            found = find_particles(make_algorithm(name, {}), shots[0].observation)
            scores = score_particles(found, shots[0], cameras, None)
            figures[name] = {key: [scores[key]] for key in ("f1", "ghosts", "true")}
    return figures


def _score_volume(solver: Solver, scene: Scene, shot: Shot) -> dict[str, float]:
    """Score a volume: Q, and F1 and ghosts (percent) of its local maxima."""
    estimate = solver.solve(shot.observation)
    scores = score_frame(build_rig(scene).grid, shot.particles, shot.views, estimate)
    kept = {"q": "q", "ghosts": "peak_ghost_percent", "f1": "peak_f1"}
    return {key: round(scores[score] or 0.0, 5) for key, score in kept.items()}


def _together(scores: list[dict[str, float]]) -> dict[str, list[float]]:
    return {key: [one[key] for one in scores] for key in scores[0]}


def fit(record: dict[str, Any]) -> dict[str, Any]:
    """Fit the model to scenes of a record, as `expected_scores.json` holds it."""
    fitted = [one for number, one in record.items() if int(number) not in NOT_FITTED]
    stored: dict[str, Any] = {
        "source": "benchmarks/planner.py fit",
        "names": list(model.FEATURES),
        "features": [one["features"] for one in fitted],
        "scores": {
            key: [None if np.isnan(value) else round(value, 5) for value in _scores(fitted, score)]
            for key, score in model.SCORES.items()
        },
        "widening": dict.fromkeys(model.SCORES, 1.0),
        "kernels": {key: _kernel(_START) for key in model.SCORES},
    }
    for key, process in model.read_model(stored).processes.items():
        likely = _most_likely(process)
        stored["kernels"][key] = _kernel(likely)
        process = replace(process, kernel=_as_kernel(likely))
        stored["widening"][key] = round(_widening(fitted, model.SCORES[key], process), 4)
    return stored


_START = np.log([*[3.0] * len(model.FEATURES), 1.0, 0.5, 0.2])
_PRIOR = (np.log(3.0), 0.2)  # weak: of the logarithm of the lengths, mean and inverse deviation


def _most_likely(process: GaussianProcess) -> F64:
    """Find the logarithms of lengths, amplitude, slope and noise that fit best."""

    def surprise(numbers: F64) -> tuple[float, F64]:
        """Compute the surprise with its prior, and the gradient: equation 5.9."""
        own = replace(process, kernel=_as_kernel(numbers))
        near = _as_kernel(np.array([*numbers[:-2], -np.inf, -np.inf]))(own.points, own.points)
        linear = own.kernel.slope**2 * (1.0 + own.points @ own.points.T)
        inverse, weights = own._inverse, own._weights
        pull = inverse - np.outer(weights, weights)
        drawn, points = pull * near, own.points / own.kernel.lengths
        shares = drawn.sum(axis=1) @ points**2 - np.sum(points * (drawn @ points), axis=0)
        noise = own.kernel.noise**2 * np.trace(pull)
        mean, weight = _PRIOR
        off = weight**2 * (numbers[:-3] - mean)
        value = own.surprise() + 0.5 * float(off @ (numbers[:-3] - mean))
        return value, np.array([*(shares + off), drawn.sum(), np.sum(pull * linear), noise])

    bounds = [*[(-1.5, 5.0)] * len(model.FEATURES), (-3.0, 2.0), (-5.0, 2.0), (-3.5, 0.5)]
    found: F64 = minimize(surprise, _START, jac=True, method="L-BFGS-B", bounds=bounds).x
    return found


def _as_kernel(numbers: F64) -> Kernel:
    return Kernel(np.exp(numbers[:-3]), *np.exp(numbers[-3:]))


def _kernel(numbers: F64) -> dict[str, Any]:
    kernel = _as_kernel(numbers)
    deviations = _rounded(np.array([kernel.amplitude, kernel.slope, kernel.noise]))
    names = ("amplitude", "slope", "noise")
    return {"lengths": _rounded(kernel.lengths), **dict(zip(names, deviations, strict=True))}


def _rounded(values: F64) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def _scores(scenes: Sequence[dict[str, Any]], score: model.ExpectedScore) -> F64:
    """Average a score over the draws of each scene, NaN where it was not measured.

    Ghosts are per true particle, and their mean is the geometric one.
    """
    return np.array([_mean(score.score, _draws(one, score)) for one in scenes])


def _widening(
    scenes: Sequence[dict[str, Any]], score: model.ExpectedScore, process: GaussianProcess
) -> float:
    """Compute the factor of errors with which 68 % of single data sets are within them.

    Each scene is predicted from the others.
    """
    drawn = [draws for one in scenes if len(draws := _draws(one, score))]
    deviations = 1.0 / np.sqrt(np.diag(process._inverse))
    off = [
        np.abs(model.link_function(score.score, draws) - mean) / deviation
        for draws, mean, deviation in zip(drawn, process.left_out(), deviations, strict=True)
    ]
    return float(np.quantile(np.concatenate(off), 0.683))


def _draws(scene: dict[str, Any], score: model.ExpectedScore) -> F64:
    values = np.array(scene["scores"].get(score.solver, {}).get(score.score, []))
    return values / (100.0 if score.score == "ghosts" else 1.0)


def _mean(score: str, values: F64) -> float:
    if not len(values):
        return float("nan")
    if score == "ghosts":
        return float(model.unlink(score, model.link_function(score, values).mean()))
    return float(values.mean())


def report(record: dict[str, Any]) -> None:
    """Print the errors of the bundled model on fitted scenes and on the others."""
    loaded = model.read_model(json.loads(model.MODEL.read_text(encoding="utf-8")))
    others = [record[str(number)] for number in TESTED]
    features = np.array([one["features"] for one in others])
    for key, score in model.SCORES.items():
        process = loaded.processes[key]
        measured, left_out = (
            model.unlink(score.score, values) for values in (process.values, process.left_out())
        )
        print(f"{key}, each from the other fitted scenes: {_compare(score, measured, left_out)}")
        expected, _ = loaded.predict(key, features)
        print(f"{key}, not fitted: {_compare(score, _scores(others, score), expected)}")


def _compare(score: model.ExpectedScore, measured: F64, expected: F64) -> str:
    """Describe errors: ghosts by factors, where there are more than some."""
    known = np.isfinite(measured)
    if score.score == "ghosts":
        known &= measured >= _SOME_GHOSTS
        factor = np.exp(np.abs(np.log((expected[known] + 1e-3) / measured[known])))
        within = np.mean(factor <= 1.5)
        median = np.median(factor)
        return f"{known.sum()} scenes, median factor {median:.2f}, {within:.0%} within 1.5"
    rms = np.sqrt(np.mean((expected - measured)[known] ** 2))
    return f"{known.sum()} scenes, rms {rms:.3f}"


def main() -> None:
    """Measure scenes, compute their figures again, or fit what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("measure", "figures", "fit"))
    parser.add_argument("--scenes", type=int, default=700)
    parser.add_argument("--output", type=Path, default=RECORD)
    chosen = parser.parse_args()
    record = json.loads(chosen.output.read_text()) if chosen.output.exists() else {}
    if chosen.what == "fit":
        model.MODEL.write_text(json.dumps(fit(record)) + "\n", encoding="utf-8")
        report(record)
        return
    if chosen.what == "figures":
        for key, one in record.items():
            one["features"] = _features(draw_scene(int(key)))
        chosen.output.write_text(json.dumps(record) + "\n", encoding="utf-8")
        return
    for number in range(chosen.scenes):
        if str(number) in record:
            continue
        scene = draw_scene(number)
        record[str(number)] = {"features": _features(scene), "scores": measure(scene, number)}
        chosen.output.write_text(json.dumps(record) + "\n", encoding="utf-8")
        used = resource.getrusage(resource.RUSAGE_SELF)
        print(number, record[str(number)]["scores"], f"{used.ru_utime:.0f} s", flush=True)


if __name__ == "__main__":
    main()
