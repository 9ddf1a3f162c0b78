"""Tables of suite `standard` in Markdown: the main score of every task, case and solver.

    python benchmarks/standard_tables.py [--records FOLDER ...]

Reads the records of `sabench run suites/standard` that are newest, of the suite's present cases:
means over the seeds with half of the 95 % confidence interval (Student's t) where there are
several.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sabench.evaluation.records import latest, read_records
from sabench.evaluation.suite_loading import load_suite
from sabench.utils.confidence import mean_of

SUITE = "standard"
TABLES = (  # first part of the cases' names, score, its name, digits
    ("reconstruction", "q", "Reconstruction, Q", 3),
    ("tracking", "f1", "Tracking, F1", 3),
    ("velocimetry", "rms_voxel", "Velocimetry, root mean square error in voxels", 3),
    ("calibration", "true_px", "Calibration, mean true reprojection error, px", 4),
    ("bubbles", "f1_large", "Bubbles of 0.5 mm and more, F1", 3),
    ("see-through", "read_percent", "See-through, correctly read cells, %", 1),
)
Row = dict[str, str]  # solver: score


def read_tables(folders: list[Path]) -> dict[str, dict[str, Row]]:
    """Read the scores: by the first and the second part of a case's name."""
    return tables_of(latest([one for folder in folders for one in read_records(folder)]))


def tables_of(records: Sequence[Any]) -> dict[str, dict[str, Row]]:
    """Choose the scores of the suite's present cases among records."""
    _, cases = load_suite(SUITE)
    places = {(one.name, one.data_hash): n for n, one in enumerate(cases)}
    placed = [(places.get((one["case"], one["scene_hash"])), one) for one in records]
    own = [(place, one["seed"], one) for place, one in placed if place is not None]
    own = [one for *_, one in sorted(own, key=lambda each: each[:2])]
    return {kind: collect(own, f"{kind}-", key, digits) for kind, key, _, digits in TABLES}


def collect(records: Sequence[Any], kind: str, key: str, digits: int) -> dict[str, Row]:
    """Collect a score of all cases whose names begin alike."""
    found: dict[str, dict[str, list[float]]] = {}
    for record in records:
        if record["case"].startswith(kind):
            row = found.setdefault(record["case"].removeprefix(kind), {})
            values = row.setdefault(record["label"] or record["solver"], [])
            if record.get(key) is not None:
                values.append(record[key])
    return {
        case: {solver: _text(values, digits) for solver, values in row.items()}
        for case, row in found.items()
    }


def _text(values: list[float], digits: int) -> str:
    mean = mean_of(values)
    if mean is None:
        return "-"
    return mean.text(digits) if mean.count > 1 else f"{mean.mean:.{digits}f}"


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
    chosen = parser.parse_args()
    found = read_tables(chosen.records)
    for kind, _, shown, _ in TABLES:
        print(f"{shown}:\n\n{table(found[kind])}\n")


if __name__ == "__main__":
    main()
