"""Standings of a task: solvers against groups of cases, ranks, and curves.

A curve is a score over one property of the scenes: density, cameras, noise. The page has standings
as values of JSON, and as plain tables for browsers without scripts.
"""

import json
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from sabench import plugins, tasks
from sabench.evaluation.leaderboard.cells import (
    Cell,
    Result,
    compare_results,
    fill_column,
    mean_rank,
    newest,
)
from sabench.evaluation.leaderboard.page_content import details_of, pair, short, table_of, text_of
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.evaluation.suite_loading import scenes_of
from sabench.scenes import Scene
from sabench.scenes.calibration import Calibration
from sabench.tasks.task import Task

_GROUP = ("task", "suite", "scene", "renderer", "split")
# words for keys of scenes; others are shown as they are
_QUANTITIES = {
    "particles.per_pixel": "particles per pixel",
    "particles.count": "particles",
    "bubbles.void_fraction": "void fraction",
    "cameras": "cameras",
    "illumination.pulse_energy_mj": "pulse energy, mJ (less light: more noise)",
    "sensor.read_noise_e": "read noise, electrons",
    "detection.noise_px": "noise of detected points, px",
    "calibration.shift_px": "calibration error, px",
    "calibration.center_mm": "calibration error, mm",
}
_LOGARITHMIC = {"illumination.pulse_energy_mj"}
Facts = dict[str, Any]


@dataclass(frozen=True)
class _CaseSeries:
    """Cases that differ in one property alone.

    Attributes
    ----------
    quantity : words for the property.
    logarithmic : whether its axis is.
    points : pairs of its value and the case's place on the page, rising.
    """

    task: str
    quantity: str
    logarithmic: bool
    points: tuple[tuple[float, int], ...]


def curves_of(cases: Sequence[Sequence[Record]]) -> list[_CaseSeries]:
    """Find all curves among cases, as the page has them.

    Scenes of bundled suites are compared by all their facts, other cases by their varied values.
    """
    groups: dict[str, dict[int, Facts]] = {}
    bundled = {table.file.stem: table.file for table in plugins.tables("suite")}
    for place, rows in enumerate(cases):
        head = rows[0] | details_of(rows)
        if not table_of(head).recorded and (facts := _facts(head, bundled)):
            groups.setdefault(key_of(head, _GROUP), {})[place] = facts
    return [
        _CaseSeries(
            cases[points[0][1]][0]["task"], _QUANTITIES.get(key, key), key in _LOGARITHMIC, points
        )
        for group in groups.values()
        for key, points in _varied(group)
    ]


def _varied(group: Mapping[int, Facts]) -> Iterator[tuple[str, tuple[tuple[float, int], ...]]]:
    """Yield each property with the cases that differ in it alone, usual ones first."""
    order = list(_QUANTITIES)
    keys = {key for facts in group.values() for key in facts}
    for key in sorted(keys, key=lambda name: (order.index(name) if name in order else 99, name)):
        alike: dict[str, list[tuple[float, int]]] = {}
        for place, facts in group.items():
            value = facts.get(key)
            if isinstance(value, int | float) and not isinstance(value, bool):
                rest = {name: fact for name, fact in facts.items() if name != key}
                alike.setdefault(key_of({"rest": rest}, ("rest",)), []).append((value, place))
        for points in alike.values():
            if len({value for value, _ in points}) > 1:
                yield key, tuple(sorted(points))


def _facts(row: Record, bundled: Mapping[str, Path]) -> Facts:
    """List the properties of a case by dotted keys; bundled suites are by name."""
    file = bundled.get(row.get("suite") or "")
    scene = scenes_of(file).get(row["scene_hash"]) if file else None
    return _flatten(_comparable(scene)) if scene else dict(row.get("axes") or {})


def _comparable(scene: Scene) -> Facts:
    """Make a scene's table with the number of cameras in place of their layout.

    Nominal cameras without errors have errors of zero.
    """
    table = scene.to_dict()
    exact = Calibration().model_dump(mode="json", exclude_none=True)
    array = {key: value for key, value in table["cameras"].items() if key != "layout"}
    calibration = exact | table.get("calibration", {})
    return {
        **table,
        "title": "",
        "calibration": calibration,
        "cameras": scene.cameras.count,
        "camera": array,
    }


def _flatten(table: Mapping[str, Any], head: str = "") -> Facts:
    """Flatten tables within tables to dotted keys; without None."""
    flat: Facts = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{head}{key}.")
        elif value is not None:
            flat[f"{head}{key}"] = value
    return flat


DIFFICULTIES = ("easy", "standard", "hard")
_MOST_COLUMNS = 6  # columns of cases without a difficulty; more cases are averaged in one


@dataclass(frozen=True)
class Line:
    """Standing of an entry.

    Attributes
    ----------
    result : one of its rows.
    place : 1 is the best mean rank; None where it misses a column.
    also : names of later submissions of the same result.
    """

    result: Result
    cells: tuple[Cell, ...]
    mean_rank: float
    place: int | None = None
    also: tuple[Record, ...] = ()

    @property
    def missing(self) -> int:
        """Number of columns without a rank."""
        return sum(cell.rank is None for cell in self.cells)

    @property
    def complete(self) -> bool:
        """True if it has a rank in every column."""
        return not self.missing


@dataclass(frozen=True)
class Column:
    """Cases of one difficulty, or one case.

    Attributes
    ----------
    cases : their places on the page.
    seeds : number of data sets of each that are compared.
    """

    name: str
    cases: tuple[int, ...]
    seeds: int


@dataclass(frozen=True)
class Board:
    """Standings in one suite, by one renderer, on public or private data sets."""

    task: Task
    suite: str
    renderer: str
    split: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]


def boards_of(cases: Sequence[Sequence[Record]]) -> list[Board]:
    """Make the standings of all tasks from cases and their rows.

    Cases and rows have the order of the page. Recorded cases have no standings. Of two cases of one
    name, as two versions of a suite have them, the one with the newer records counts.
    """
    numbers = iter(range(sum(len(rows) for rows in cases)))
    results = [
        Result(next(numbers), place, row | details)
        for place, rows in enumerate(cases)
        for details in [details_of(rows)]
        for row in rows
    ]
    scored = sorted((result for result in results if not table_of(result.row).recorded), key=_group)
    boards = [_board(list(group)) for _, group in groupby(scored, key=_group)]
    return sorted(
        boards,
        key=lambda board: (
            sum(column.name in DIFFICULTIES for column in board.columns) == 0,
            -len(board.lines),
            board.suite,
        ),
    )


def _group(result: Result) -> tuple[str, ...]:
    row = result.row
    return row["task"], row.get("suite") or row["scene"], row["renderer"], row["split"]


def _board(results: list[Result]) -> Board:
    task_name, suite, renderer, split = _group(results[0])
    task, cases = tasks.of(task_name), _newest_cases(results)
    grouped = _columns(cases)
    compared = {number: compare_results(of_case) for number, of_case in cases.items()}
    columns, cells, names = [], list[dict[str, Cell]](), list[dict[str, Hashable]]()
    for name, numbers in grouped:
        members = [compared[number] for number in numbers]
        seeds = min(len(case.data) for case in members)
        columns.append(Column(name, tuple(numbers), seeds))
        filled, signed = fill_column(task, members)
        cells.append(filled)
        names.append(signed)
    lines = _placed(list(_lines(results, cells, names)))
    return Board(task, suite, renderer, split, tuple(columns), tuple(lines))


def _newest_cases(results: list[Result]) -> dict[int, list[Result]]:
    """Group results by their cases; of several versions of a case, keep the newest."""
    cases: dict[int, list[Result]] = {}
    for result in results:
        cases.setdefault(result.case, []).append(result)
    by_name: dict[str, tuple[str, int]] = {}
    for number, of_case in cases.items():
        name = of_case[0].row["case"]
        date = max(newest(result.row) for result in of_case)
        by_name[name] = max(by_name.get(name, ("", -1)), (date, number))
    numbers = sorted(number for _, number in by_name.values())
    return {number: cases[number] for number in numbers}


def _columns(cases: dict[int, list[Result]]) -> list[tuple[str, list[int]]]:
    heads = {number: of_case[0].row for number, of_case in cases.items()}
    graded = {
        level: [
            number
            for number, row in heads.items()
            if row.get("difficulty") == level and not row.get("axis")
        ]
        for level in DIFFICULTIES
    }
    if any(graded.values()):
        return [(level, numbers) for level, numbers in graded.items() if numbers]
    if len(heads) > _MOST_COLUMNS:
        return [(f"all {len(heads)} cases", list(heads))]
    return [(row["case"], [number]) for number, row in heads.items()]


def _lines(
    results: list[Result], cells: Sequence[dict[str, Cell]], names: Sequence[dict[str, Hashable]]
) -> Iterator[Line]:
    """Make the lines; a result that was sent again shares the line of the first one."""
    # count the different results of a column that have a rank
    last = [
        len({name[entry] for entry, cell in column.items() if cell.rank})
        for column, name in zip(cells, names, strict=True)
    ]
    same: dict[Hashable, list[Line]] = {}
    entries: dict[str, Result] = {}
    for candidate in sorted(results, key=_seniority):
        entries.setdefault(candidate.entry, candidate)
    for entry, result in entries.items():
        row = tuple(column.get(entry, Cell(None, None, "not measured")) for column in cells)
        if any(cell.places for cell in row):
            line = Line(result, row, mean_rank([cell.rank for cell in row], last))
            same.setdefault(tuple(name.get(entry) for name in names), []).append(line)
    for first, *others in same.values():
        yield replace(first, also=tuple(other.result.row for other in others))


def _seniority(result: Result) -> tuple[bool, str, str, str]:
    """Compute the sort key of a result: the first submission comes first."""
    sent = result.row.get("submission") or {}
    first = min((run.get("date") or "" for run in result.row["runs"]), default="")
    return bool(sent), sent.get("date", ""), first, result.entry


def _placed(lines: list[Line]) -> list[Line]:
    """Order lines by mean rank, incomplete ones last, and give the others places."""
    complete = [line.mean_rank for line in lines if line.complete]
    for n, line in enumerate(lines):
        if line.complete:
            lines[n] = replace(line, place=1 + sum(other < line.mean_rank for other in complete))
    return sorted(lines, key=lambda line: (line.missing, line.mean_rank, line.result.place))


# lines of one suite, the best first, and of all suites for browsers without scripts
_MOST_LINES = 100


def front_of(cases: Sequence[Sequence[Record]]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Describe the standings of cases and their rows for the page.

    Returns also the same as a table for browsers without scripts.
    """
    boards = boards_of(cases)
    front = {
        "boards": [_describe(board) for board in boards],
        "curves": [
            {
                "task": curve.task,
                "quantity": curve.quantity,
                "logarithmic": curve.logarithmic,
                "points": [[short(value), place] for value, place in curve.points],
            }
            for curve in curves_of(cases)
        ],
    }
    return front, list(_static(boards))


def _describe(board: Board) -> dict[str, Any]:
    lines = board.lines[:_MOST_LINES]
    cells = zip(*(line.cells for line in board.lines), strict=True)
    counts = [Counter(cell.rank for cell in column) for column in cells]  # ranks of each column
    names = _names([line.result.row for line in lines])
    task, first = board.task, board.task.columns[0]
    words = "or more" if first.better == "larger" else "or less"
    return {
        "task": board.task.name,
        "title": _title(board),
        "columns": [
            {"name": column.name, "cases": list(column.cases), "seeds": column.seeds}
            for column in board.columns
        ],
        "sufficient": f"{first.heading} of {task.sufficient:g} {words}",
        "more": len(board.lines) - len(lines),
        "lines": [
            {
                "row": line.result.place,
                "name": name,
                "place": line.place,
                "meanRank": short(line.mean_rank),
                "also": [_sender(row) for row in line.also],
                "cells": [_cell(cell, n) for cell, n in zip(line.cells, counts, strict=True)],
            }
            for line, name in zip(lines, names, strict=True)
        ],
    }


def _cell(cell: Cell, counts: Mapping[int | None, int]) -> dict[str, Any]:
    """Describe a cell for the page; what is false or missing is left out."""
    values = {
        "rank": cell.rank,
        "tied": cell.rank is not None and counts[cell.rank] > 1,
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


def _title(board: Board) -> str:
    private = ", private test set" if board.split == "hidden" else ""
    return f"suite {board.suite}, renderer {board.renderer}{private}"


def _sender(row: Record) -> str:
    by = f" by {row['submission']['name']}" if row.get("submission") else ""
    return f"{row.get('label') or row['solver']}{by}"


def _names(rows: Sequence[Record]) -> list[str]:
    """Name entries; add the differing parameters to equal names."""
    shown = [row.get("label") or row["solver"] for row in rows]
    counts = Counter(shown)
    names = []
    for name, row in zip(shown, rows, strict=True):
        others = [row["parameters"] for text, row in zip(shown, rows, strict=True) if text == name]
        more = _difference(row["parameters"], others) if counts[name] > 1 else ""
        names.append(f"{name} ({more})" if more else name)
    return names


def _difference(parameters: Record, all_: Sequence[Record]) -> str:
    differ = {
        key: value
        for key, value in parameters.items()
        if len({json.dumps(other.get(key), sort_keys=True) for other in all_}) > 1
    }
    return text_of(differ)


def _static(boards: Sequence[Board]) -> Iterator[dict[str, Any]]:
    """Make plain tables of the standings, as many lines as a page can hold."""
    left = _MOST_LINES
    for board in boards:
        lines = board.lines[: max(left, 0)]
        left -= len(lines)
        if lines:
            yield {
                "task": board.task.name.replace("_", " "),
                "title": _plain(_title(board)),
                "columns": [
                    _plain(f"{column.name}: {board.task.columns[0].heading}")
                    for column in board.columns
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
