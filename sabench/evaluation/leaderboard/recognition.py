"""Submitted estimates that are those of an earlier record under another name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sabench import plugins
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import read_records, same_data
from sabench.utils.validation import printable


def bundled_records(leaderboard: Path) -> list[Record]:
    """Read the records that sabench brings, unless they are the leaderboard's own."""
    folder = plugins.bundled_folder("leaderboard") / "records"
    own = folder.resolve() == (leaderboard / "records").resolve()
    return [] if own or not folder.is_dir() else read_records(folder)


def recognise(record: Record, known: Sequence[Record]) -> str | None:
    """Name the other solver entry whose estimates a submitted record has, if any.

    Estimates are the same if they are of the same data set and have the same content hash. A run of
    a solver is not another entry than a result of the solver by its own name. Records that repeat
    others' estimates themselves do not count.
    """
    first = [
        one
        for one in known
        if one.get("estimate_hash") == record["estimate_hash"]
        and same_data(one, record)
        and not one.get("same_estimates_as")
    ]
    other = all(_is_other(one, record) for one in first)
    return _entry(first[0]) if first and other else None


def _is_other(one: Record, record: Record) -> bool:
    if one["solver"] != record["solver"]:
        return True
    sender = (one.get("submission") or {}).get("name")
    return sender not in (None, record["submission"]["name"])


def _entry(record: Record) -> str:
    who = f" of {record['submission']['name']}" if record.get("submission") else ""
    return printable(f"{record['solver']}{who}", 200)
