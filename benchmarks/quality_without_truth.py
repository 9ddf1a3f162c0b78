"""Figures of `sabench quality`, which need no truth, against the true scores of the same results.

    python benchmarks/quality_without_truth.py [--solvers NAME ...] [--densities N ...]
        [--output benchmarks/records/quality-without-truth.json] [--tables]

Cases: four cameras of 120 x 160 pixels in air, four frames, 0.01 to 0.1 particles per pixel, bright
or dim light, true cameras or cameras off by 0.4 px; solvers of particles. At 0.1 particles per
pixel the record holds `ray_triangulation` alone, since the others take too long to solve nine times
a case. Each figure is compared with its true counterpart over all cases by Spearman's rank
correlation: 1 or -1 where the figure orders the results as the truth does. --tables prints the
tables of docs/using/quality.md from the record. What the file holds of other cases stays.
"""

import argparse
import itertools
import json
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from sabench.scenes import Scene, find, parse_scene  # noqa: E402
from sabench.simulation.pipeline import generate  # noqa: E402
from sabench.tasks.quality import quality  # noqa: E402
from sabench.tasks.solve_and_score import score, solve  # noqa: E402

RECORD = ROOT / "benchmarks/records/quality-without-truth.json"
SOLVERS = ("bayesian_ipr", "shake_the_box", "ray_triangulation")
DENSITIES = (0.01, 0.03, 0.06, 0.1)
LIGHT = {"bright": 7.0, "dim": 0.7}  # mJ
OFF = {"true cameras": 0.0, "cameras off": 0.4}  # px
# figure without truth, true score
PAIRS = (
    ("residual_px", "rms_px"),
    ("explained", "recall"),
    ("held_out", "precision"),
    ("held_out_correlation", "f1"),
    ("ghost_percent", "ghost_percent"),
    ("chance_percent", "ghost_percent"),
    ("jitter_mm", "rms_mm"),
    ("followed", "effectiveness"),
)


def make_scene(density: float, light: str, off: str) -> Scene:
    """Make the scene of a case."""
    values = tomllib.loads(find("particle-tracking-air", "scenes").read_text(encoding="utf-8"))
    values["volume"]["size_mm"] = [8.4, 6.3, 4.0]
    values["cameras"] |= {"rows": 120, "columns": 160}
    values["grid"]["crop_mm"] = [0.6, 0.6, 0.0]
    values["illumination"]["pulse_energy_mj"] = LIGHT[light]
    values["particles"]["per_pixel"] = density
    values["frames"] = 4
    if OFF[off]:
        values["calibration"] = {"shift_px": OFF[off]}
    return parse_scene(values, "quality")


def measure(density: float, light: str, off: str, solvers: list[str]) -> list[dict[str, Any]]:
    """Solve a case by each solver, and judge the results with and without truth."""
    measured = []
    with tempfile.TemporaryDirectory(prefix="sabench-") as name:
        folder = Path(name)
        data = generate(make_scene(density, light, off), folder / "data", seed=17, backend="splat")
        for solver in solvers:
            out = folder / f"{solver}.h5"
            solve(solver, data, out)
            true = score(data, out)
            figures = quality(data, out).figures
            measured.append(
                {
                    "density": density,
                    "light": light,
                    "cameras": off,
                    "solver": solver,
                    "figures": figures,
                    "true": {key: true[key] for key in dict.fromkeys(one for _, one in PAIRS)},
                }
            )
    return measured


def correlations(cases: list[dict[str, Any]]) -> list[tuple[str, str, float, int]]:
    """Correlate the ranks of each figure with those of its true counterpart.

    Returns both keys, the correlation and the number of cases that have both.
    """
    from scipy.stats import spearmanr

    rows = []
    for key, true in PAIRS:
        both = [(one["figures"][key], one["true"][true]) for one in cases]
        known = np.array([pair for pair in both if None not in pair], dtype=float).reshape(-1, 2)
        varies = len(known) > 2 and bool((np.ptp(known, axis=0) > 0.0).all())
        value = float(spearmanr(*known.T).statistic) if varies else float("nan")
        rows.append((key, true, value, len(known)))
    return rows


def table(cases: list[dict[str, Any]]) -> list[str]:
    """Make the lines of a table of rank correlations: over all cases, and by each solver."""
    solvers = sorted({one["solver"] for one in cases}, key=SOLVERS.index)
    groups = [cases, *([one for one in cases if one["solver"] == name] for name in solvers)]
    columns = [correlations(group) for group in groups]
    head = ["figure", "true score", "all", *(f"`{name}`" for name in solvers)]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for rows in zip(*columns, strict=True):
        cells = [f"{value:.2f}" if np.isfinite(value) else "-" for _, _, value, _ in rows]
        lines.append(f"| `{rows[0][0]}` | `{rows[0][1]}` | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Measure the cases that are asked for, or print tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--solvers", nargs="+", default=list(SOLVERS), choices=SOLVERS)
    parser.add_argument("--densities", nargs="+", type=float, default=list(DENSITIES))
    parser.add_argument("--output", type=Path, default=RECORD)
    parser.add_argument("--tables", action="store_true")
    chosen = parser.parse_args()
    known: list[dict[str, Any]] = []
    if chosen.output.is_file():
        known = json.loads(chosen.output.read_text(encoding="utf-8"))["cases"]
    if chosen.tables:
        print("\n".join(table(known)))
        return
    for density, light, off in itertools.product(chosen.densities, LIGHT, OFF):
        for one in measure(density, light, off, chosen.solvers):
            same = [key for key in one if key not in ("figures", "true")]
            known = [old for old in known if any(old[key] != one[key] for key in same)]
            known.append(one)
            print(json.dumps(one))
        text = json.dumps({"cases": known}, indent=1, sort_keys=True) + "\n"
        chosen.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
