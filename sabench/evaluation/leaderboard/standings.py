"""Standings of a task: solvers against easy, standard and hard cases, with ranks."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from sabench import tasks
from sabench.evaluation.leaderboard.cells import Cell, fill_column
from sabench.evaluation.leaderboard.comparison import Result, compare, newest
from sabench.evaluation.leaderboard.page_content import details_of
from sabench.evaluation.leaderboard.ranking import mean_rank
from sabench.evaluation.leaderboard.score_columns import table_of
from sabench.evaluation.record_schema import Record
from sabench.tasks.task import Task

DIFFICULTIES = ("easy", "standard", "hard")
_MOST_COLUMNS = 6  # of cases without a difficulty; more of them are averaged in one column


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
        filled, signed = fill_column(task, own)
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


def _lines(
    results: list[Result],
    cells: Sequence[dict[str, Cell]],
    names: Sequence[dict[str, Hashable]],
) -> Iterator[Line]:
    """Make the lines; a result that was sent again shares the line of the first one."""
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
    """Order lines by mean rank, incomplete ones last, and give the others places."""
    complete = [line.mean_rank for line in lines if line.complete]
    placed = [
        replace(line, place=1 + sum(other < line.mean_rank for other in complete))
        if line.complete
        else line
        for line in lines
    ]
    return sorted(placed, key=lambda one: (one.missing, one.mean_rank, one.result.place))
