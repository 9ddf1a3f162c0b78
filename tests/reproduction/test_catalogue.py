"""The catalogue of the thesis, and verdicts of its entries."""

from __future__ import annotations

from collections import Counter

import pytest

from reproduction import MEASUREMENTS
from reproduction.catalogue import (
    MEASURED,
    UNSTATED,
    Entry,
    judge,
    read_catalogue,
    read_rows,
    rows_of,
)
from reproduction.common import verdict

CHAPTERS = {"1": 3, "2": 19, "3": 8, "4": 31, "5": 30, "6": 6, "c": 21}
BEYOND = {  # ours, or claims in the text
    "table-2-1-best",
    "fig-2-7-cameras",
    "section-2-2-2",
    "section-2-3-2",
    "section-2-4",
    "section-3-2-1",
    "fig-5-28",
    "flow-behind-bodies",
    "drops-over-time",
    "three-phases",
}


def test_it_holds_every_table_and_figure_once() -> None:
    names = [entry.name for entry in read_catalogue()]
    tables = [name for name in names if name.startswith("table-")]
    assert tables == [
        f"table-{number}" for number in ("2-1", "2-2", "2-3", "3-1", "4-1", "5-1", "5-2")
    ]
    figures = [name.split("-") for name in names if name.startswith("fig-")]
    assert Counter(chapter for _, chapter, _ in figures) == CHAPTERS
    for chapter, count in CHAPTERS.items():
        numbers = [int(number) for _, own, number in figures if own == chapter]
        assert numbers == list(range(1, count + 1))


def test_what_measures_an_entry_exists_and_all_that_measures_is_in_it() -> None:
    entries = read_catalogue()
    used = {entry.item for entry in entries if entry.item}
    assert used == set(MEASUREMENTS) - BEYOND
    assert all(bool(entry.item) != bool(entry.unmeasured) for entry in entries)
    assert not [entry.name for entry in entries if entry.rows and not entry.item]


def test_every_entry_has_rows_in_the_record() -> None:
    rows = read_rows(MEASURED)
    measured = {row["item"] for row in rows}
    for entry in read_catalogue():
        if entry.item in measured:
            assert rows_of(entry, rows), entry.name
    assert not [row["name"] for row in rows if row["pixels"]]


ROWS = [("Q of nine", "reproduced"), ("Q of five", "exceeds"), ("spread", UNSTATED)]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        (Entry("fig-1", "", "here"), "1 reproduced, 1 exceeds"),
        (Entry("fig-1", "", "here", "nine"), "reproduced"),
        (Entry("fig-1", "", "here", "spread"), "measured; the thesis has no value"),
        (Entry("fig-1", "", "there"), "not measured yet"),
        (Entry("fig-1", "", unmeasured="photograph"), "photograph"),
    ],
)
def test_verdicts_are_summed_up(entry: Entry, expected: str) -> None:
    rows = [{"item": "here", "name": name, "verdict": verdict} for name, verdict in ROWS]
    assert judge(entry, rows) == expected


def test_a_smaller_error_exceeds_and_a_quantity_differs() -> None:
    assert verdict(0.9, 1.0, "larger") == "below"
    assert verdict(1.1, 1.0, "larger") == "exceeds"
    assert verdict(0.9, 1.0, "smaller") == "exceeds"
    assert verdict(1.1, 1.0, "smaller") == "below"
    assert verdict(1.1, 1.0) == "differs"
    assert verdict(1.04, 1.0, "smaller") == "reproduced"
    assert verdict(1.0, None) == UNSTATED
