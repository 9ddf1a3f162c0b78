"""Tables of suite `standard` from records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from benchmarks.standard_tables import collect, read_tables, table

ROOT = Path(__file__).resolve().parents[3]
RECORDS: list[dict[str, Any]] = [
    {"case": "tracking-easy", "solver": "own", "label": None, "f1": 0.99},
    {"case": "tracking-easy", "solver": "optv", "label": "second", "f1": None},
    {"case": "tracking-hard", "solver": "own", "label": None, "f1": 0.7},
    {"case": "bubbles-hard", "solver": "own", "label": None, "f1": 0.1},
]


def test_a_table_has_a_row_for_each_case_and_a_column_for_each_solver() -> None:
    lines = table(collect(RECORDS, "tracking-", "f1", 3)).splitlines()
    assert lines == [
        "| case | own | second |",
        "|---|---|---|",
        "| easy | 0.990 | - |",
        "| hard | 0.700 | - |",
    ]


def test_several_seeds_have_a_mean_and_an_interval() -> None:
    records = [{**RECORDS[0], "f1": 0.9 + 0.1 * seed} for seed in (0, 1)]
    row = collect(records, "tracking-", "f1", 2)["easy"]
    assert row == {"own": "0.95 ± 0.64"}  # t = 12.7 times the standard error


def test_no_records_are_no_rows(tmp_path: Path) -> None:
    assert not any(read_tables([tmp_path]).values())


def test_the_bundled_records_are_of_the_present_version() -> None:
    found = read_tables([ROOT / "leaderboard" / "records"])
    assert all(found.values())
    assert set(found["reconstruction"]) >= {"easy", "standard", "hard"}
