"""Results of one case that are compared: one for each entry, on the same data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from sabench import tasks
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of

_ENTRY = ("solver", "parameters", "submission")  # on whichever machine it ran
_SAME_DIGITS = 9  # of scores of one result, which another machine's rounding may change beyond


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
            self._runs[entry] = self._select(entry)
        return self._runs[entry]

    def _select(self, entry: str) -> dict[int, Record]:
        result = self.results.get(entry)
        runs = _runs_by_data(result.row) if result else {}
        there = {seed: runs.get(data) for seed, data in self.data.items()}
        return {seed: run for seed, run in there.items() if run and not run.get("error")}


def compare(results: Sequence[Result]) -> ComparedCase:
    """Select the data sets on which the results of one case are compared.

    They are those of the run with the most seeds: an entry with fewer is incomplete, so that one
    lucky seed ranks before nobody. Submissions can add no seed where there is any run. Of runs
    with as many, the data that most entries have count, then the newest.
    """
    own = [one for one in results if not one.row.get("submission")] or results
    sets = [frozenset(_data_of(one.row).items()) for one in own]
    counts, dates = Counter(sets), [newest(one.row) for one in own]
    keys = [(len(data), counts[data], date) for data, date in zip(sets, dates, strict=True)]
    data = dict(sorted(sets[keys.index(max(keys))]))
    chosen: dict[str, Result] = {}
    for one in sorted(results, key=lambda one: (_common(one.row, data), newest(one.row))):
        chosen[one.entry] = one
    return ComparedCase(data, chosen)


def signature(task_name: str, runs: dict[int, Record]) -> Hashable | None:
    """Identify a result by its scores on each seed.

    None where they could agree by chance: without any score that is measured and not counted.
    """
    shown = [one for one in tasks.of(task_name).scores if not one.hidden and one.unit != "s"]
    telling = [one.key for one in shown if not one.counted and one.better != "steady"]
    if not any(run.get(key) is not None for run in runs.values() for key in telling):
        return None
    return tuple(
        (seed, *(_digits(run.get(one.key)) for one in shown)) for seed, run in sorted(runs.items())
    )


def distinct(records: Sequence[Record]) -> list[Record]:
    """Select one record of each result, of records of one data set and task."""
    named = [signature(one["task"], {one["seed"]: one}) for one in records]
    keys = [name or number for number, name in enumerate(named)]
    return list(dict(zip(keys, records, strict=True)).values())


def _digits(value: float | None) -> str:
    return "" if value is None else f"{value:.{_SAME_DIGITS}g}"


def newest(row: Record) -> str:
    """Return the date of the newest run of a row; "" without any."""
    return max((run.get("date") or "" for run in row["runs"]), default="")


def _common(row: Record, data: dict[int, str]) -> int:
    return len(_runs_by_data(row).keys() & set(data.values()))


def _data_of(row: Record) -> dict[int, str]:
    return {run["seed"]: _data_key(run) for run in row["runs"]}


def _runs_by_data(row: Record) -> dict[str, Record]:
    return {_data_key(run): run for run in row["runs"]}


def _data_key(run: Record) -> str:
    """Identify a data set and its seed; copies share an identity."""
    return f"{run['seed']} {run.get('identity') or run['dataset']}"
