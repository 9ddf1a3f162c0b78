"""Standings of a task: solvers against easy, standard and hard cases, with ranks."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from sabench import tasks
from sabench.evaluation.leaderboard.comparison import (
    ComparedCase,
    Result,
    compare,
    newest,
    signature,
)
from sabench.evaluation.leaderboard.ranking import mean_rank, ranks_of_distinct
from sabench.evaluation.leaderboard.score_columns import table_of
from sabench.evaluation.record_schema import Record
from sabench.tasks.task import Task
from sabench.utils.confidence import Mean, mean_of

DIFFICULTIES = ("easy", "standard", "hard")
_MOST_COLUMNS = 6  # of cases without a difficulty; more of them are averaged in one column


@dataclass(frozen=True)
class Cell:
    """Result of an entry in a column.

    Attributes
    ----------
    rank : 1 is the best; None: `note` gives the reason.
    score : mean of the first score, over the seeds; None without any.
    best : whether its mean is the best one.
    seconds, kernels : time of the solver, and the same over that of the reference kernel.
    sufficient : whether it is accurate enough for its speed to count.
    fastest : whether it is the fastest one of these.
    whole_process : whether its seconds are those of a program's whole process.
    places : of its rows on the page.
    """

    rank: int | None
    score: Mean | None
    note: str = ""
    best: bool = False
    seconds: float | None = None
    kernels: float | None = None
    sufficient: bool = False
    fastest: bool = False
    whole_process: bool = False
    places: tuple[int, ...] = ()


@dataclass(frozen=True)
class Line:
    """Standing of an entry.

    Attributes
    ----------
    result : one of its rows.
    place : 1 is the best mean rank; None where it misses a column.
    also : names under which the same result was sent again.
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
    """Make the standings of all tasks from cases and their rows, as the page has them.

    Recorded cases have none. Of two cases of one name, as an earlier version of a suite has them,
    the one with the newer records counts.
    """
    numbers = iter(range(sum(len(rows) for rows in cases)))
    results = [
        Result(next(numbers), place, row) for place, rows in enumerate(cases) for row in rows
    ]
    scored = sorted((one for one in results if not table_of(one.row).recorded), key=_group)
    boards = [_board(list(group)) for _, group in groupby(scored, key=_group)]
    return sorted(boards, key=lambda one: (_grades(one) == 0, -len(one.lines), one.suite))


def _group(one: Result) -> tuple[str, ...]:
    row = one.row
    return row["task"], row.get("suite") or row["scene"], row["renderer"], row["split"]


def _grades(board: Board) -> int:
    return sum(column.name in DIFFICULTIES for column in board.columns)


def _board(results: list[Result]) -> Board:
    task_name, suite, renderer, split = _group(results[0])
    task, cases = tasks.of(task_name), _newest_cases(results)
    grouped = _columns(cases)
    compared = {number: compare(own) for number, own in cases.items()}
    columns, cells, names = [], list[dict[str, Cell]](), list[dict[str, Hashable]]()
    for name, numbers in grouped:
        own = [compared[number] for number in numbers]
        seeds = min(len(one.data) for one in own)
        columns.append(Column(name, tuple(numbers), seeds))
        filled, signed = _fill(task, own)
        cells.append(filled)
        names.append(signed)
    lines = _placed(list(_lines(results, cells, names)))
    return Board(task, suite, renderer, split, tuple(columns), tuple(lines))


def _newest_cases(results: list[Result]) -> dict[int, list[Result]]:
    """Group results by their cases; of several versions of a case, keep the newest."""
    cases: dict[int, list[Result]] = {}
    for one in results:
        cases.setdefault(one.case, []).append(one)
    by_name: dict[str, tuple[str, int]] = {}
    for number, own in cases.items():
        name = own[0].row["case"]
        by_name[name] = max(by_name.get(name, ("", -1)), (max(newest(o.row) for o in own), number))
    kept = sorted(number for _, number in by_name.values())
    return {number: cases[number] for number in kept}


def _columns(cases: dict[int, list[Result]]) -> list[tuple[str, list[int]]]:
    """Make columns of the difficulties, or else of all cases."""
    heads = {number: own[0].row for number, own in cases.items()}
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


def _fill(task: Task, cases: list[ComparedCase]) -> tuple[dict[str, Cell], dict[str, Hashable]]:
    """Make the cells of a column, and names that tell different results apart."""
    entries = list(dict.fromkeys(entry for case in cases for entry in case.results))
    cells = {entry: _cell(task, cases, entry) for entry in entries}
    signed = [[signature(task.name, case.runs(entry)) for case in cases] for entry in entries]
    names: dict[str, Hashable] = {
        entry: tuple(own) if all(own) else entry for entry, own in zip(entries, signed, strict=True)
    }
    ranked = [entry for entry, cell in cells.items() if not cell.note]
    if ranked:
        values = np.array([_values(task, cases, entry) for entry in ranked])
        larger = task.columns[0].better == "larger"
        found = ranks_of_distinct(values, larger, [names[entry] for entry in ranked])
        best = max if larger else min
        top = best(mean_ for entry in ranked if (mean_ := _mean(cells[entry])) is not None)
        for entry, rank in zip(ranked, found, strict=True):
            cells[entry] = replace(cells[entry], rank=rank, best=_mean(cells[entry]) == top)
    return _with_speed(task, cells), names


def _mean(cell: Cell) -> float | None:
    return cell.score.mean if cell.score else None


def _values(task: Task, cases: list[ComparedCase], entry: str) -> list[float]:
    """List the first score of a complete entry for each seed, averaged over the cases.

    Cases without a common seed give one value.
    """
    key = task.columns[0].key
    own = [case.runs(entry) for case in cases]
    seeds = sorted(set.intersection(*(set(case.data) for case in cases)))
    if not seeds:
        return [
            math.fsum(_average([run[key] for run in runs.values()]) or 0.0 for runs in own)
            / len(own)
        ]
    return [math.fsum(runs[seed][key] for runs in own) / len(own) for seed in seeds]


def _cell(task: Task, cases: list[ComparedCase], entry: str) -> Cell:
    """Make the cell of an entry, still without its rank."""
    key, note = task.columns[0].key, _note(cases, entry)
    runs = [run for case in cases for run in case.runs(entry).values()]
    places = tuple(case.results[entry].place for case in cases if entry in case.results)
    if note:
        partial = [run[key] for run in runs if run[key] is not None] if len(cases) == 1 else []
        return Cell(None, mean_of(partial), note, places=places)
    kernels = [
        run["seconds"] / run["reference_s"]
        for run in runs
        if run["seconds"] is not None and run.get("reference_s")
    ]
    return Cell(
        None,
        mean_of(_values(task, cases, entry)),
        seconds=_average([run["seconds"] for run in runs]),
        kernels=_average(kernels) if len(kernels) == len(runs) else None,
        whole_process=any(run.get("whole_process") for run in runs),
        places=places,
    )


def _average(values: list[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return math.fsum(there) / len(there) if there else None


def _note(cases: list[ComparedCase], entry: str) -> str:
    """Say why an entry has no rank in these cases; "" for one that has."""
    results = [case.results.get(entry) for case in cases]
    there = [one.row for one in results if one]
    if len(there) < len(cases):
        return f"{len(there)} of {len(cases)} cases"
    if failed := [row for row in there if row["error"]]:
        runs = [run for row in failed for run in row["runs"] if run.get("error")]
        return "declined" if all(run.get("declined") for run in runs) else "failed"
    for case in cases:
        if (count := len(case.runs(entry))) < len(case.data):
            return f"{count} of {len(case.data)} seeds"
    return "" if all(row["ranked"] for row in there) else "not ranked"


def _with_speed(task: Task, cells: dict[str, Cell]) -> dict[str, Cell]:
    """Mark the fastest of the entries that are accurate enough.

    Kernels are compared, which differ little between machines; without them nothing is.
    """
    larger, least = task.columns[0].better == "larger", task.sufficient
    enough = {
        entry: cell.rank is not None
        and (mean_ := _mean(cell)) is not None
        and (mean_ >= least if larger else mean_ <= least)
        for entry, cell in cells.items()
    }
    times = {
        entry: cells[entry].kernels
        for entry, meets in enough.items()
        if meets and cells[entry].kernels is not None
    }
    best = min(times.values(), key=lambda value: value or 0.0, default=None)
    return {
        entry: replace(
            cell, sufficient=enough[entry], fastest=entry in times and times[entry] == best
        )
        for entry, cell in cells.items()
    }


def _lines(
    results: list[Result],
    cells: Sequence[dict[str, Cell]],
    names: Sequence[dict[str, Hashable]],
) -> Iterator[Line]:
    """Make the lines; a result that was sent again under another name shares the first one's."""
    last = [_distinct(own, name) for own, name in zip(cells, names, strict=True)]
    same: dict[Hashable, list[Line]] = {}
    entries: dict[str, Result] = {}
    for one in sorted(results, key=_seniority):
        entries.setdefault(one.entry, one)
    for entry, result in entries.items():
        own = tuple(column.get(entry, Cell(None, None, "no result")) for column in cells)
        if any(cell.places for cell in own):
            line = Line(result, own, mean_rank([cell.rank for cell in own], last))
            same.setdefault(tuple(name.get(entry) for name in names), []).append(line)
    for first, *others in same.values():
        yield replace(first, also=tuple(other.result.row for other in others))


def _distinct(cells: dict[str, Cell], names: dict[str, Hashable]) -> int:
    """Count the different results of a column that have a rank."""
    return len({names[entry] for entry, cell in cells.items() if cell.rank})


def _seniority(one: Result) -> tuple[bool, str, str, str]:
    """Compute the key by which the first sender of a result comes first."""
    sent = one.row.get("submission") or {}
    first = min((run.get("date") or "" for run in one.row["runs"]), default="")
    return bool(sent), sent.get("date", ""), first, one.entry


def _placed(lines: list[Line]) -> list[Line]:
    """Order lines by mean rank, those that miss a column last, and give the others places."""
    complete = [line.mean_rank for line in lines if line.complete]
    placed = [
        replace(line, place=1 + sum(other < line.mean_rank for other in complete))
        if line.complete
        else line
        for line in lines
    ]
    return sorted(placed, key=lambda one: (one.missing, one.mean_rank, one.result.place))
