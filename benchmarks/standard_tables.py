"""Tables of suite `standard` in Markdown: the main score of every task, case and solver.

    python benchmarks/standard_tables.py [--records FOLDER ...] [--seed N]

Reads the records of `sabench run suites/standard` that are newest, of the suite's present version.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Any

from sabench.evaluation.records import latest, read_records
from sabench.scenes.bundled import find

_TABLES = (  # first part of the cases' names, score, its name, digits
    ("reconstruction", "q", "Reconstruction, Q", 3),
    ("tracking", "f1", "Tracking, F1", 3),
    ("velocimetry", "rms_voxel", "Velocimetry, root mean square error in voxels", 3),
    ("calibration", "true_px", "Calibration, mean true reprojection error, px", 4),
    ("bubbles", "f1_large", "Bubbles of 0.5 mm and more, F1", 3),
    ("see-through", "read_percent", "See-through, correctly read cells, %", 1),
)
Row = dict[str, str]  # solver: score


def read_tables(folders: list[Path], seed: int) -> dict[str, dict[str, Row]]:
    """Read the scores of one seed: by the first and the second part of a case's name."""
    suite = tomllib.loads(find("standard", "scenes/suites").read_text(encoding="utf-8"))
    asked = ("standard", suite["version"], seed)
    names = [case["name"] for case in suite["cases"]]
    records = latest([one for folder in folders for one in read_records(folder)])
    own = [one for one in records if (one["suite"], one["version"], one["seed"]) == asked]
    return {
        kind: collect(
            sorted(own, key=lambda one: names.index(one["case"])), f"{kind}-", key, digits
        )
        for kind, key, _, digits in _TABLES
    }


def collect(records: list[Any], kind: str, key: str, digits: int) -> dict[str, Row]:
    """Collect a score of all cases whose names begin alike."""
    rows: dict[str, Row] = {}
    for record in records:
        if record["case"].startswith(kind):
            value = record.get(key)
            text = "-" if value is None else f"{value:.{digits}f}"
            row = rows.setdefault(record["case"].removeprefix(kind), {})
            row[record["label"] or record["solver"]] = text
    return rows


def table(rows: dict[str, Row]) -> str:
    """Write a table: a row for each case, a column for each solver."""
    solvers = list(dict.fromkeys(solver for row in rows.values() for solver in row))
    lines = ["| case | " + " | ".join(solvers) + " |", "|---" * (1 + len(solvers)) + "|"]
    for case, row in rows.items():
        lines.append(f"| {case} | " + " | ".join(row.get(one, "-") for one in solvers) + " |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=Path, nargs="+", default=[Path("leaderboard/records")])
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    found = read_tables(chosen.records, chosen.seed)
    for kind, _, shown, _ in _TABLES:
        print(f"{shown}:\n\n{table(found[kind])}\n")


if __name__ == "__main__":
    main()
