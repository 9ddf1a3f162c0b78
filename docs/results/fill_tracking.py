"""Fill the table of particle-tracking.md from the record of benchmarks/particle_tracking.py.

Run python docs/results/fill_tracking.py after the benchmark has changed its record; tests/docs
compares page and record. The first two cells of a row stay, and so does the order of rows.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "results" / "particle-tracking.md"
RECORD = ROOT / "benchmarks" / "records" / "particle-tracking.json"
CASES = {  # the page's words, and the record's name
    "equal light, 0.05 ppp": "equal 0.05",
    "single particles' Mie, oblique light, 0.05 ppp": "own 0.05",
    "equal light, 0.10 ppp": "equal 0.10",
    "equal light, 0.15 ppp": "equal 0.15",
    "equal light, 0.20 ppp": "equal 0.20",
    "equal light, 0.20 ppp, no pixel saturated": "dim 0.20",
}
_CONVERGED = (10, 11)  # frames


def tracking_cells(rows: Sequence[dict[str, Any]]) -> list[str]:
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
        *(f"{mean(one):.3f}" for one in ("link_recall", "link_precision", "effectiveness")),
        f"{mean('velocity_percent'):.1f}",
        f"{mean('cpu_s'):.1f}",
    ]


def filled(text: str) -> str:
    """Return the page's text with its table made anew."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    lines = []
    for line in text.split("\n"):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) > 2 and cells[0] in CASES:
            cells[2:] = tracking_cells(record[CASES[cells[0]]][cells[1].strip("`")])
            line = f"| {' | '.join(cells)} |"
        lines.append(line)
    return "\n".join(lines)


def main() -> None:
    """Write the page anew."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
