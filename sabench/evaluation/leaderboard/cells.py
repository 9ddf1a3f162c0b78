"""Cells of the standings: results of entries in the cases of one column."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, replace

import numpy as np

from sabench.evaluation.leaderboard.comparison import ComparedCase, signature
from sabench.evaluation.leaderboard.ranking import ranks_of_distinct
from sabench.tasks.task import Task
from sabench.utils.confidence import Mean, mean_of


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


def fill_column(
    task: Task, cases: list[ComparedCase]
) -> tuple[dict[str, Cell], dict[str, Hashable]]:
    """Make the cells of the entries, and names that tell different results apart."""
    entries = list(dict.fromkeys(entry for case in cases for entry in case.results))
    cells = {entry: _cell(task, cases, entry) for entry in entries}
    signed = [[signature(task.name, case.runs(entry)) for case in cases] for entry in entries]
    names: dict[str, Hashable] = {
        entry: tuple(own) if all(own) else entry for entry, own in zip(entries, signed, strict=True)
    }
    return _with_speed(task, _with_ranks(task, cases, cells, names)), names


def _with_ranks(
    task: Task,
    cases: list[ComparedCase],
    cells: dict[str, Cell],
    names: dict[str, Hashable],
) -> dict[str, Cell]:
    """Rank the complete cells and mark the best mean."""
    ranked = [entry for entry, cell in cells.items() if not cell.note]
    if not ranked:
        return cells
    values = np.array([_values(task, cases, entry) for entry in ranked])
    larger = task.columns[0].better == "larger"
    found = ranks_of_distinct(values, larger, [names[entry] for entry in ranked])
    means = values.mean(axis=1)
    top = means.max() if larger else means.min()
    marked = {
        entry: replace(cells[entry], rank=rank, best=bool(mean == top))
        for entry, rank, mean in zip(ranked, found, means, strict=True)
    }
    return cells | marked


def _mean(cell: Cell) -> float | None:
    return cell.score.mean if cell.score else None


def _values(task: Task, cases: list[ComparedCase], entry: str) -> list[float]:
    """Average the first score of a complete entry over the cases, for each seed.

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
    there = [value for value in values if value is not None and math.isfinite(value)]
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
    best = min((time for time in times.values() if time is not None), default=None)
    return {
        entry: replace(
            cell, sufficient=enough[entry], fastest=entry in times and times[entry] == best
        )
        for entry, cell in cells.items()
    }
