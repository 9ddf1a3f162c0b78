"""Tables of suites `particles` and `particle-tracks` in Markdown: scores of every case and solver.

    python benchmarks/particle_tables.py [--records FOLDER ...] [--seeds N ...]

Reads the newest records of `sabench run suites/particles` and `sabench run suites/particle-tracks`,
of the suites' present scenes. Cells are means over the seeds with half of the 95 % confidence
interval where there are several.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.standard_tables import Row, table
from sabench.evaluation.records import latest, read_records
from sabench.evaluation.suite_loading import load_suite
from sabench.utils.confidence import mean_of

_TABLES = (  # suite, score, its name, digits
    ("particles", "f1", "F1", 3),
    ("particles", "ghost_percent", "Ghosts, %", 1),
    ("particles", "rms_px", "RMS distance in the images, px", 3),
    ("particle-tracks", "f1", "F1", 3),
    ("particle-tracks", "link_recall", "Link recall", 3),
    ("particle-tracks", "link_precision", "Link precision", 3),
    ("particle-tracks", "effectiveness", "Effectiveness", 3),
)


def collect(records: list[Any], cases: list[str], key: str, digits: int) -> dict[str, Row]:
    """Collect a score: a row for each case that has records, a cell for each solver."""
    values: dict[str, dict[str, list[float]]] = {}
    for record in records:
        row = values.setdefault(record["case"], {})
        cell = row.setdefault(record["label"] or record["solver"], [])
        if record.get(key) is not None:
            cell.append(record[key])
    return {
        case: {solver: _cell(own, digits) for solver, own in values[case].items()}
        for case in cases
        if case in values
    }


def _cell(values: list[float], digits: int) -> str:
    mean = mean_of(values)
    return "-" if mean is None else mean.text(digits)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=Path, nargs="+", default=[Path("leaderboard/records")])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    chosen = parser.parse_args()
    records = latest([one for folder in chosen.records for one in read_records(folder)])
    suites = {
        name: load_suite(f"suites/{name}")[1]
        for name in dict.fromkeys(name for name, *_ in _TABLES)
    }
    for name, key, shown, digits in _TABLES:
        scenes = {case.name: case.data_hash for case in suites[name]}
        own = [
            one
            for one in records
            if one["suite"] == name and one["scene_hash"] == scenes.get(one["case"])
        ]
        own = [one for one in own if one["seed"] in chosen.seeds]
        print(f"{name}, {shown}:\n\n{table(collect(own, list(scenes), key, digits))}\n")


if __name__ == "__main__":
    main()
