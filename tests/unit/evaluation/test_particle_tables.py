"""Tables of the suites of particles from records."""

from __future__ import annotations

from benchmarks.particle_tables import collect
from benchmarks.standard_tables import table

RECORDS = [
    {"case": "hard", "solver": "one", "label": None, "seed": 1, "f1": 0.5},
    {"case": "easy", "solver": "one", "label": None, "seed": 1, "f1": 0.9},
    {"case": "easy", "solver": "two", "label": "own", "seed": 1, "f1": None},
    {"case": "other", "solver": "one", "label": None, "seed": 1, "f1": 0.1},
]


def test_rows_are_in_the_order_of_the_suite_and_cells_are_means() -> None:
    lines = table(collect(RECORDS, ["easy", "missing", "hard"], "f1", 3)).splitlines()
    assert lines == [
        "| case | one | own |",
        "|---|---|---|",
        "| easy | 0.900 | - |",
        "| hard | 0.500 | - |",
    ]
    twice = [*RECORDS, {"case": "easy", "solver": "one", "label": None, "seed": 2, "f1": 0.7}]
    cell = collect(twice, ["easy"], "f1", 3)["easy"]["one"]
    assert cell.startswith("0.800 ± ")
