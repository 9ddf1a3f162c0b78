"""Standings and curves for the page: values of JSON, and plain tables."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from sabench.evaluation.leaderboard.cells import Cell
from sabench.evaluation.leaderboard.curves import curves_of
from sabench.evaluation.leaderboard.page_content import pair, short, text_of
from sabench.evaluation.leaderboard.standings import Board, boards_of
from sabench.evaluation.record_schema import Record
from sabench.tasks.task import Task

_MOST_LINES = 100  # of one suite, the best first
_MOST_STATIC = 200  # lines of the table for browsers without scripts


def front_of(cases: Sequence[Sequence[Record]]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Describe the standings of cases and their rows for the page.

    Returns also the same as a table for browsers without scripts.
    """
    boards = boards_of(cases)
    front = {
        "boards": [_describe(board) for board in boards],
        "curves": [
            {
                "task": one.task,
                "quantity": one.quantity,
                "logarithmic": one.logarithmic,
                "points": [[short(value), place] for value, place in one.points],
            }
            for one in curves_of(cases)
        ],
    }
    return front, list(_static(boards))


def _describe(board: Board) -> dict[str, Any]:
    lines = board.lines[:_MOST_LINES]
    tied = [_tied([line.cells[n] for line in board.lines]) for n in range(len(board.columns))]
    names = _names([line.result.row for line in lines])
    return {
        "task": board.task.name,
        "title": _title(board),
        "columns": [
            {"name": one.name, "cases": list(one.cases), "seeds": one.seeds}
            for one in board.columns
        ],
        "sufficient": _sufficient(board.task),
        "more": len(board.lines) - len(lines),
        "lines": [
            {
                "row": line.result.place,
                "name": name,
                "place": line.place,
                "meanRank": short(line.mean_rank),
                "also": [_sender(row) for row in line.also],
                "cells": [_cell(cell, own) for cell, own in zip(line.cells, tied, strict=True)],
            }
            for line, name in zip(lines, names, strict=True)
        ],
    }


def _cell(cell: Cell, tied: set[int]) -> dict[str, Any]:
    """Describe a cell for the page; what is false or missing is left out."""
    values = {
        "rank": cell.rank,
        "tied": cell.rank in tied,
        "best": cell.best,
        "score": pair(cell.score),
        "note": cell.note,
        "seconds": None if cell.seconds is None else short(cell.seconds),
        "kernels": None if cell.kernels is None else short(cell.kernels),
        "sufficient": cell.sufficient,
        "fastest": cell.fastest,
        "process": cell.whole_process,
        "places": list(cell.places),
    }
    return {key: value for key, value in values.items() if value not in (None, False, "")}


def _tied(cells: Sequence[Cell]) -> set[int]:
    """List the ranks that several entries of a column share."""
    counts = Counter(cell.rank for cell in cells if cell.rank is not None)
    return {rank for rank, count in counts.items() if count > 1}


def _title(board: Board) -> str:
    private = ", private test set" if board.split == "hidden" else ""
    return f"suite {board.suite}, renderer {board.renderer}{private}"


def _sufficient(task: Task) -> str:
    first = task.columns[0]
    words = "or more" if first.better == "larger" else "or less"
    return f"{first.heading} of {task.sufficient:g} {words}"


def _sender(row: Record) -> str:
    by = f" by {row['submission']['name']}" if row.get("submission") else ""
    return f"{row.get('label') or row['solver']}{by}"


def _names(rows: Sequence[Record]) -> list[str]:
    """Name entries; those of one name with the parameters in which they differ."""
    shown = [row.get("label") or row["solver"] for row in rows]
    counts = Counter(shown)
    names = []
    for name, row in zip(shown, rows, strict=True):
        others = [own["parameters"] for one, own in zip(shown, rows, strict=True) if one == name]
        more = _difference(row["parameters"], others) if counts[name] > 1 else ""
        names.append(f"{name} ({more})" if more else name)
    return names


def _difference(own: Record, all_: Sequence[Record]) -> str:
    """Format the parameters that are not the same in all of them."""
    differ = {
        key: value
        for key, value in own.items()
        if len({json.dumps(one.get(key), sort_keys=True) for one in all_}) > 1
    }
    return text_of(differ)


def _static(boards: Sequence[Board]) -> Iterator[dict[str, Any]]:
    """Make plain tables of the standings, as many lines as a page can hold."""
    left = _MOST_STATIC
    for board in boards:
        lines = board.lines[: max(left, 0)]
        left -= len(lines)
        if lines:
            yield {
                "task": board.task.name.replace("_", " "),
                "title": _plain(_title(board)),
                "columns": [
                    _plain(f"{one.name}: {board.task.columns[0].heading}") for one in board.columns
                ],
                "left": len(board.lines) - len(lines),
                "lines": [
                    {
                        "place": line.place or "-",
                        "name": _plain(_sender(line.result.row)) + _mark(line.result.row),
                        "rank": f"{line.mean_rank:.2f}",
                        "cells": [_words(board.task, cell) for cell in line.cells],
                    }
                    for line in lines
                ],
            }


def _mark(row: Record) -> str:
    """Mark a solver that could have read the truth."""
    return " (not isolated)" if any(run.get("isolated") is False for run in row["runs"]) else ""


def _plain(text: str) -> str:
    """Replace halves of surrogate pairs, which no file can hold."""
    return text.encode("utf-8", "replace").decode()


def _words(task: Task, cell: Cell) -> str:
    score = cell.score.text(task.columns[0].decimals) if cell.score else ""
    rank = f"{cell.rank}." if cell.rank else cell.note
    return f"{rank} {score}".strip()
