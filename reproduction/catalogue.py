"""Catalogue of the thesis: 7 tables, 118 figures, and what was measured for each."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.utils.errors import InputError

_HERE = Path(__file__).parent
MEASURED = _HERE / "measured.json"  # rows of `sabench reproduce all -o FILE`
UNSTATED = "not in the thesis"  # verdict of a value that the thesis does not state
_ORDER = ("reproduced", "exceeds", "differs", "below", "not reproduced", "not reached")


@dataclass(frozen=True)
class Entry:
    """Table or figure of the thesis.

    Attributes
    ----------
    name : table-2-1, fig-c-21, ...
    shows : what is on it.
    item : name of the measurement that `sabench reproduce` repeats; empty where none does.
    rows : regular expression of the names of its rows that belong here.
    unmeasured : why nothing measures it; empty where something does.
    """

    name: str
    shows: str
    item: str = ""
    rows: str = ""
    unmeasured: str = ""


def read_catalogue() -> list[Entry]:
    """Read all entries, tables first, in the thesis's order."""
    text = (_HERE / "catalogue.toml").read_text(encoding="utf-8")
    return [Entry(name, **fields) for name, fields in tomllib.loads(text).items()]


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Read rows that `sabench reproduce -o FILE` wrote; none where there is no file.

    Raises InputError: a file that holds something else.
    """
    if not file.exists():
        return []
    try:
        rows: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))
        valid = all({"item", "name", "verdict"} <= row.keys() for row in rows)
    except (ValueError, AttributeError, TypeError, OSError):
        valid = False
    if not valid:
        raise InputError(f"{file}: expected rows that `sabench reproduce -o` wrote")
    return rows


def rows_of(entry: Entry, rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Select the rows that belong to an entry."""
    return [row for row in rows if row["item"] == entry.item and re.search(entry.rows, row["name"])]


def judge(entry: Entry, rows: Sequence[Mapping[str, Any]]) -> str:
    """Sum up an entry: a verdict, counts of verdicts, or why there is none."""
    if entry.unmeasured:
        return entry.unmeasured
    measured = rows_of(entry, rows)
    if not measured:
        return "not measured yet"
    counts = Counter(str(row["verdict"]) for row in measured if row["verdict"] != UNSTATED)
    if not counts:
        return "measured; the thesis has no value"
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in _ORDER if counts[verdict])


def judged(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """List all entries with their verdicts by the rows."""
    return [
        {
            "name": entry.name,
            "shows": entry.shows,
            "item": entry.item,
            "verdict": judge(entry, rows),
        }
        for entry in read_catalogue()
    ]
