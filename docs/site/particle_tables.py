"""Tables of particle solvers, in Markdown, from the records of benchmarks."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markdown_table import written

RECORDS = Path(__file__).resolve().parents[2] / "benchmarks" / "records"
_NOTHING = "-"
_PEERS = ("openlpt", "optv", "ray_triangulation", "mlos_smart", "msa")
DENSITIES = {  # case, number of cameras: name in the record
    ("equal light, 0.01 ppp", 4): "equal 0.01",
    ("equal light, 0.02 ppp", 4): "equal 0.02",
    ("equal light, 0.05 ppp", 4): "equal 0.05",
    ("equal light, 0.10 ppp", 4): "equal 0.10",
    ("equal light, 0.125 ppp", 4): "equal 0.125",
    ("equal light, 0.15 ppp", 4): "equal 0.15",
    ("equal light at 0.10 ppp, cameras off by 0.1 px", 4): "off 0.10",
    ("equal light at 0.10 ppp, Mitsuba's images", 4): "mitsuba 0.10",
    ("equal light, 0.05 ppp", 9): "nine 0.05",
    ("the same, half of the volume hidden from one camera", 9): "hidden 0.05",
    ("equal light, 0.10 ppp", 9): "nine 0.10",
    ("equal light, 0.20 ppp", 9): "equal 0.20",
    ("equal light, 0.25 ppp", 9): "equal 0.25",
    ("equal light, 0.05 ppp", 13): "thirteen 0.05",
    ("equal light, 0.10 ppp", 13): "thirteen 0.10",
    ("equal light, 0.20 ppp", 13): "thirteen 0.20",
    ("equal light, 0.30 ppp", 13): "thirteen 0.30",
    ("equal light, 0.40 ppp", 13): "thirteen 0.40",
    ("equal light, 0.50 ppp", 13): "thirteen 0.50",
    ("equal light, 0.05 ppp", 25): "twentyfive 0.05",
    ("equal light, 0.10 ppp", 25): "twentyfive 0.10",
    ("equal light, 0.20 ppp", 25): "twentyfive 0.20",
    ("equal light, 0.30 ppp", 25): "twentyfive 0.30",
    ("equal light, 0.40 ppp", 25): "twentyfive 0.40",
    ("equal light, 0.50 ppp", 25): "twentyfive 0.50",
    ("mild scatter (0.3) at 0.05 ppp", 4): "scatter 0.05",
    ("mild scatter (0.3) at 0.10 ppp", 4): "scatter 0.10",
    ("mild scatter (0.3) at 0.20 ppp", 9): "scatter nine 0.20",
    ("single particles' Mie, 0.01 ppp", 9): "own 0.01",
    ("single particles' Mie, 0.05 ppp", 4): "front 0.05",
    ("single particles' Mie, 0.10 ppp", 4): "front 0.10",
    ("single particles' Mie, oblique light, 0.05 ppp", 4): "own 0.05",
    ("images of 0.25 px on a quarter of the sensor, 0.05 ppp", 4): "narrow",
    ("the realistic scene, 0.005 ppp", 9): "realistic 0.005",
    ("the realistic scene, 0.02 ppp", 9): "realistic 0.02",
    ("the realistic scene, 0.05 ppp", 9): "realistic",
    ("the standard suite's hard case, one frame", 4): "hard",
}
_TRACKERS = ("shake_the_box", "openlpt", "optv")
_CONVERGED = (10, 11)  # frames
SEQUENCES = {  # case: name in the record
    "equal light, 0.05 ppp": "equal 0.05",
    "single particles' Mie, oblique light, 0.05 ppp": "own 0.05",
    "equal light, 0.10 ppp": "equal 0.10",
    "equal light, 0.15 ppp": "equal 0.15",
    "equal light, 0.20 ppp": "equal 0.20",
    "equal light, 0.20 ppp, no pixel saturated": "dim 0.20",
}

Rows = Sequence[dict[str, Any]]


def scores(row: dict[str, Any] | None, digits: int) -> str:
    """Write recall, ghosts and distance of one measurement."""
    if row is None or "recall" not in row:
        return _NOTHING
    rms = row["rms_px"]  # none where nothing was found
    distance = _NOTHING if rms is None else f"{rms:.{digits}f}"
    return f"{row['recall']:.1f}, {row['ghosts']:.1f}, {distance}"


def density_cells(of: dict[str, Rows]) -> list[str]:
    """Write the cells of a case after its number of cameras."""
    own = of.get("bayesian_ipr", ())
    seeds = {row["seed"]: row for row in own}
    bound = [row["rms_over_bound"] for row in own if "rms_over_bound" in row]
    covered = [68.27 * row["coverage_68"] for row in own if "coverage_68" in row]
    return [
        *(scores(seeds.get(seed), 2) for seed in (1, 2)),
        f"{np.mean(bound):.2f}" if bound else _NOTHING,
        f"{np.mean(covered):.0f} %" if covered else _NOTHING,
        *(scores(next(iter(of.get(peer, ())), None), 2) for peer in _PEERS),
    ]


def density() -> str:
    """Write particles found and ghosts of each case and solver."""
    record = _read("particle-density")
    head = ["case", "cameras", "`bayesian_ipr`, seed 1", "seed 2", "rms / bound", "within 68 %"]
    rows = (
        [words, str(cameras), *density_cells(record.get(name, {}))]
        for (words, cameras), name in DENSITIES.items()
    )
    return written([*head, *(f"`{peer}`" for peer in _PEERS)], rows)


def tracking() -> str:
    """Write the scores of trackers, a row for each case and solver."""
    head = ["case", "solver", "found %", "ghosts %", "rms px", "link recall", "link precision"]
    head += ["effectiveness", "velocity error %", "CPU s per frame"]
    return written(head, _tracking_rows(_read("particle-tracking")))


def _tracking_rows(record: dict[str, dict[str, Rows]]) -> Iterator[list[str]]:
    for words, case in SEQUENCES.items():
        for solver in (name for name in _TRACKERS if name in record[case]):
            yield [words, f"`{solver}`", *tracking_cells(record[case][solver])]


def tracking_cells(rows: Rows) -> list[str]:
    """Write the cells of a solver after its name: means over the seeds."""
    late = [[row["frames"][frame] for frame in _CONVERGED] for row in rows]

    def converged(score: str) -> float:
        return float(np.mean([[frame[score] for frame in frames] for frames in late]))

    def mean(score: str) -> float:
        return float(np.mean([row[score] for row in rows]))

    return [
        f"{converged('recall'):.2f}",
        f"{converged('ghosts'):.2f}",
        f"{converged('rms_px'):.3f}",
        *(f"{mean(score):.3f}" for score in ("link_recall", "link_precision", "effectiveness")),
        f"{mean('velocity_percent'):.1f}",
        f"{mean('cpu_s'):.1f}",
    ]


def _read(name: str) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((RECORDS / f"{name}.json").read_text(encoding="utf-8"))
    return record
