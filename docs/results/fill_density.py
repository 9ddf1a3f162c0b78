"""Fill the tables of particle-density.md from the records of benchmarks.

Run python docs/results/fill_density.py after a benchmark has changed a record; tests/docs compares
page and records. The first cell of a row stays, and so does the order of rows and columns; new
cases get a row by hand.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "results" / "particle-density.md"
RECORDS = ROOT / "benchmarks" / "records"
_NOTHING = "-"
_PEERS = ("openlpt", "optv", "ray_triangulation", "mlos_smart", "msa")
CASES = {  # the page's rows: its words, the number of cameras and the record's name
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
PARTS = {
    "nothing": "all parts",
    "wider images while candidates share the light": "widening",
    "slow removal of the darkest candidates": "levels",
    "fits until all particles are settled": "settling",
    "fits of neighbours at each trial of a ghost": "refits",
    "particles tried as two": "splits",
    "learned scatter of light: any is as probable": "light free",
    "learned scatter of light: the same light in all cameras": "one light",
    "shifts of the cameras": "alignment",
    "widths that change over the volume": "widths",
    "background, bright spots and hidden areas": "background",
    "earnings of the best camera left out": "best camera",
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


def filled(text: str) -> str:
    """Return the page's text with its tables made anew."""
    density, ablation = (
        json.loads((RECORDS / f"particle-{name}.json").read_text(encoding="utf-8"))
        for name in ("density", "ablation")
    )
    columns: list[str] = []
    lines = []
    for line in text.split("\n"):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| taken out |"):
            columns = cells[1:]
        if len(cells) > 2 and cells[1].isdigit() and (cells[0], int(cells[1])) in CASES:
            case = CASES[cells[0], int(cells[1])]
            cells[2:] = density_cells(density.get(case, {}))
            line = _row(cells)
        elif len(cells) > 2 and cells[0] in PARTS:
            part = PARTS[cells[0]]
            rows = [ablation.get(case, {}).get(part, ()) for case in columns]
            line = _row([cells[0], *(scores(next(iter(own), None), 3) for own in rows)])
        lines.append(line)
    return "\n".join(lines)


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Write the page anew."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
