"""Cells of the standings: ranks of entries by their scores on the same data sets."""

import math
from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sabench import tasks
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.tasks.task import Task
from sabench.utils.arrays import F64, Bool
from sabench.utils.confidence import Mean, mean_of, quantile


def ranks(scores: F64, larger: bool) -> list[int]:
    """Rank entries by their scores (entry, seed) of the same data sets.

    A rank is 1 plus the number of entries that are better beyond chance: the 95 % confidence
    interval of the mean difference over the seeds, paired by seed, excludes zero. Entries without a
    significant difference share a rank, but none ranks before an entry with a better mean: a large
    scatter improves no rank. A single seed gives no interval; its scores rank as they are.
    """
    gain = np.asarray(scores if larger else -scores, dtype=np.float64)
    places, worst = [0] * len(gain), 1
    for row in np.argsort(-gain.mean(axis=1), kind="stable"):
        worst = max(worst, 1 + int(_beat(gain, gain[row]).sum()))
        places[row] = worst
    return places


def _beat(gain: F64, scores: F64) -> Bool:
    """Mark the entries (entry, seed) that are better than one (seed,) beyond chance."""
    apart = gain - scores
    mean, count = apart.mean(axis=1), apart.shape[1]
    if count == 1:
        return np.asarray(mean > 0.0)
    error = apart.std(axis=1, ddof=1) / np.sqrt(count)
    return np.asarray(mean > quantile(count) * error)


def ranks_of_distinct(scores: F64, larger: bool, names: Sequence[Hashable]) -> list[int]:
    """Rank entries; entries of one name are one result, submitted several times.

    Such a result takes one rank, so that a repeated submission lowers no other rank.
    """
    first = {name: row for row, name in reversed(list(enumerate(names)))}
    rows = sorted(first.values())
    by_row = dict(zip(rows, ranks(scores[rows], larger), strict=True))
    return [by_row[first[name]] for name in names]


def mean_rank(found: Sequence[int | None], last: Sequence[int]) -> float:
    """Average ranks over cases; a case without one counts as the rank after the last.

    Leaving out a hard case therefore improves no mean.

    Parameters
    ----------
    found : rank in each case, or None.
    last : the number of ranked results of each case.
    """
    pairs = zip(found, last, strict=True)
    return sum(most + 1 if rank is None else rank for rank, most in pairs) / len(found)


_ENTRY = ("solver", "parameters", "submission")  # on any machine
SAME_DIGITS = 9  # equal digits of one result's scores on machines with other rounding


@dataclass(frozen=True)
class Result:
    """One row of the page, with its place among all rows and that of its case."""

    place: int
    case: int
    row: Record

    @cached_property
    def entry(self) -> str:
        """Key of the solver entry."""
        return key_of(self.row, _ENTRY)


@dataclass(frozen=True)
class ComparedCase:
    """Results of one case.

    Attributes
    ----------
    data : the compared data sets by their seeds.
    results : one for each entry.
    """

    data: dict[int, str]
    results: dict[str, Result]
    _runs: dict[str, dict[int, Record]] = field(default_factory=dict)

    def runs(self, entry: str) -> dict[int, Record]:
        """Select the runs of an entry on the compared data, without failed ones, by seed."""
        if entry not in self._runs:
            result = self.results.get(entry)
            runs = _runs_by_data(result.row) if result else {}
            by_seed = {seed: runs.get(data) for seed, data in self.data.items()}
            self._runs[entry] = {
                seed: run for seed, run in by_seed.items() if run and not run.get("error")
            }
        return self._runs[entry]


def compare_results(results: Sequence[Result]) -> ComparedCase:
    """Select the data sets for the comparison of the results of one case.

    They are those of the run with the most seeds: an entry with fewer is incomplete, so that one
    good seed does not rank it first. Submissions can add no seed where there is any run. Of runs
    with as many, the data that most entries have count, then the newest.
    """
    candidates = [result for result in results if not result.row.get("submission")] or results
    sets = [
        frozenset({run["seed"]: _data_key(run) for run in result.row["runs"]}.items())
        for result in candidates
    ]
    counts, dates = Counter(sets), [newest(result.row) for result in candidates]
    keys = [(len(data), counts[data], date) for data, date in zip(sets, dates, strict=True)]
    data = dict(sorted(sets[keys.index(max(keys))]))
    chosen: dict[str, Result] = {}
    wanted = set(data.values())
    for result in sorted(
        results,
        key=lambda result: (len(_runs_by_data(result.row).keys() & wanted), newest(result.row)),
    ):
        chosen[result.entry] = result
    return ComparedCase(data, chosen)


def signature(task_name: str, runs: dict[int, Record]) -> Hashable | None:
    """Identify a result by its scores on each seed.

    None where they could agree by chance: without any score that is measured and not counted.
    """
    scores = tasks.of(task_name).scores
    shown = [score for score in scores if not score.hidden and score.unit != "s"]
    telling = [score.key for score in shown if not score.counted and score.better != "steady"]
    if not any(run.get(key) is not None for run in runs.values() for key in telling):
        return None
    return tuple(
        (seed, *(_digits(run.get(score.key)) for score in shown))
        for seed, run in sorted(runs.items())
    )


def distinct(records: Sequence[Record]) -> list[Record]:
    """Select one record of each result, of records of one data set and task."""
    named = [signature(record["task"], {record["seed"]: record}) for record in records]
    keys = [name or number for number, name in enumerate(named)]
    return list(dict(zip(keys, records, strict=True)).values())


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.{SAME_DIGITS}g}"


def newest(row: Record) -> str:
    """Return the date of the newest run of a row; "" without any."""
    return max((run.get("date") or "" for run in row["runs"]), default="")


def _runs_by_data(row: Record) -> dict[str, Record]:
    return {_data_key(run): run for run in row["runs"]}


def _data_key(run: Record) -> str:
    """Identify a data set and its seed; copies share an identity."""
    return f"{run['seed']} {run.get('identity') or run['dataset']}"


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
    """Make the cells of the entries, and a name for each different result."""
    entries = list(dict.fromkeys(entry for case in cases for entry in case.results))
    cells = {entry: _cell(task, cases, entry) for entry in entries}
    signed = [[signature(task.name, case.runs(entry)) for case in cases] for entry in entries]
    names: dict[str, Hashable] = {
        entry: tuple(key) if all(key) else entry for entry, key in zip(entries, signed, strict=True)
    }
    return _with_speed(task, _with_ranks(task, cases, cells, names)), names


def _with_ranks(
    task: Task, cases: list[ComparedCase], cells: dict[str, Cell], names: dict[str, Hashable]
) -> dict[str, Cell]:
    """Rank the complete cells and mark the best mean."""
    ranked = [entry for entry, cell in cells.items() if not cell.note]
    if not ranked:
        return cells
    values = np.array([_values(task, cases, entry) for entry in ranked])
    larger = task.columns[0].better == "larger"
    places = ranks_of_distinct(values, larger, [names[entry] for entry in ranked])
    means = values.mean(axis=1)
    top = means.max() if larger else means.min()
    marked = {
        entry: replace(cells[entry], rank=rank, best=bool(mean == top))
        for entry, rank, mean in zip(ranked, places, means, strict=True)
    }
    return cells | marked


def _values(task: Task, cases: list[ComparedCase], entry: str) -> list[float]:
    """Average the first score of a complete entry over the cases, for each seed.

    Cases without a common seed give one value.
    """
    key = task.columns[0].key
    by_case = [case.runs(entry) for case in cases]
    seeds = sorted(set.intersection(*(set(case.data) for case in cases)))
    if not seeds:
        return [
            math.fsum(_average([run[key] for run in runs.values()]) or 0.0 for runs in by_case)
            / len(by_case)
        ]
    return [math.fsum(runs[seed][key] for runs in by_case) / len(by_case) for seed in seeds]


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
    finite = [value for value in values if value is not None and math.isfinite(value)]
    return math.fsum(finite) / len(finite) if finite else None


def _note(cases: list[ComparedCase], entry: str) -> str:
    results = [case.results.get(entry) for case in cases]
    rows = [result.row for result in results if result]
    if len(rows) < len(cases):
        return f"{len(rows)} of {len(cases)} cases"
    if failed := [row for row in rows if row["error"]]:
        runs = [run for row in failed for run in row["runs"] if run.get("error")]
        return "declined" if all(run.get("declined") for run in runs) else "failed"
    for case in cases:
        if (count := len(case.runs(entry))) < len(case.data):
            return f"{count} of {len(case.data)} seeds"
    return "" if all(row["ranked"] for row in rows) else "not ranked"


def _with_speed(task: Task, cells: dict[str, Cell]) -> dict[str, Cell]:
    """Mark the fastest of the entries that are accurate enough.

    Kernels are compared, which differ little between machines; without them nothing is.
    """
    larger, least = task.columns[0].better == "larger", task.sufficient
    marked = {
        entry: replace(
            cell,
            sufficient=cell.rank is not None
            and cell.score is not None
            and (cell.score.mean >= least if larger else cell.score.mean <= least),
        )
        for entry, cell in cells.items()
    }
    times = {
        entry: cell.kernels
        for entry, cell in marked.items()
        if cell.sufficient and cell.kernels is not None
    }
    best = min(times.values(), default=None)
    return {
        entry: replace(cell, fastest=entry in times and times[entry] == best)
        for entry, cell in marked.items()
    }
