"""Measurement of a case: statistics of its data set, and figures of its solvers.

Estimates that are wrong in a known way are scored too: a bug in a metric that flatters every solver
shows in their scores.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sabench import tasks
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.evaluation.gates.baseline import (
    COSTS,
    QUALITY,
    TIMES,
    CaseEntry,
    Entry,
    Tolerances,
    tolerance_of,
)
from sabench.evaluation.gates.dataset_statistics import fingerprint
from sabench.evaluation.gates.findings import compare, scale_times
from sabench.evaluation.recorded_cases import judge
from sabench.evaluation.runner import dataset_of, discard
from sabench.evaluation.suites import Case, RecordedCase, SolverEntry
from sabench.evaluation.timed_solving import solve_timed
from sabench.tasks.external_programs import solver_name
from sabench.tasks.solve_and_score import score
from sabench.utils.errors import InputError


def score_known_wrong(data: Dataset, out: Path) -> dict[str, float]:
    """Score the wrong estimates of all tasks that a data set serves.

    Temporary results are written to `out`.

    Returns
    -------
    Scores by names like `probe.reconstruction.q`.
    """
    figures: dict[str, float] = {}
    for task in tasks.every():
        if not task.accepts(data):
            continue
        with result_writer(out, data, "probe", task.name, {}, overwrite=True) as writer:
            for frame in task.frames(data):
                writer.add(task.wrong(data, frame), frame)
        scores = score(data, out)
        known = {one.key: scores.get(one.key) for one in task.all_scores}
        figures |= {
            f"probe.{task.name}.{key}": float(value)
            for key, value in known.items()
            if value is not None
        }
    return figures


_AGAIN = 2  # repetitions for a solver that seems to have become slower
_COMPILE = "compile_s"  # depends on what the cache holds, and on nothing that a gate is about


def names_of(solver_entries: Sequence[SolverEntry], where: str) -> dict[str, SolverEntry]:
    """Name each solver of a case: by its label, or its name and parameters."""
    named = {
        (
            one.label
            or " ".join(
                # of a program its file's, which is the same on another machine
                [
                    solver_name(one.name),
                    *(f"{k}={json.dumps(v)}" for k, v in one.parameters.items()),
                ]
            )
        ): one
        for one in solver_entries
    }
    if len(named) < len(solver_entries):
        raise InputError(
            f"{where}: solvers: expected names, parameters or labels that differ, got "
            f"{len(solver_entries)} of which {len(named)} do"
        )
    return named


def task_of(solver_entry: SolverEntry) -> str:
    """Return the task of a solver entry."""
    return solver_entry.describe()[1]


def run_case(
    case: Case, work: Path, old: CaseEntry | None, tolerances: Tolerances, exit_first: bool
) -> CaseEntry:
    """Make a data set, measure its statistics, and solve and score it.

    With `exit_first` it stops as soon as something is worse.
    """
    data = dataset_of(case, work, fresh=True)
    out = work / "results" / f"{case.file_name}.h5"
    now = CaseEntry(
        case=case.name,
        seed=case.seed,
        renderer=case.renderer,
        scene_hash=case.data_hash,
        data={},
        solvers={},
    )
    if data.has_truth:
        statistics = {**fingerprint(data), **score_known_wrong(data, out)}
        now = now.model_copy(update={"data": statistics})
    for name, solver_entry in names_of(case.solvers, f"case {case.name}").items():
        if (
            exit_first
            and old
            and any(
                finding.worse
                for finding in compare(drop_not_run(old, now), now, tasks_of(case), tolerances)
            )
        ):
            break
        entry = _solve_again(
            case, data, solver_entry, out, old.solvers.get(name) if old else None, tolerances
        )
        now = now.model_copy(update={"solvers": {**now.solvers, name: entry}})
    discard(case, data)
    out.unlink(missing_ok=True)
    return now


def drop_not_run(old: CaseEntry, now: CaseEntry) -> CaseEntry:
    """Remove the solvers that have not run now from the old entry."""
    return old.model_copy(
        update={
            "solvers": {name: entry for name, entry in old.solvers.items() if name in now.solvers}
        }
    )


def tasks_of(case: Case) -> dict[str, str]:
    """Return the task of each solver of a case, by its name in the baseline."""
    return {
        name: task_of(solver_entry)
        for name, solver_entry in names_of(case.solvers, f"case {case.name}").items()
    }


def _solve_again(
    case: Case,
    data: Dataset,
    solver_entry: SolverEntry,
    out: Path,
    earlier: Entry | None,
    tolerances: Tolerances,
) -> Entry:
    """Solve and score; repeat where time or memory seem to have grown."""
    entry = _solve(case, data, solver_entry, out)
    for _ in range(_AGAIN):
        if earlier is None or not _exceeds_tolerance(
            earlier, entry, tolerances, task_of(solver_entry)
        ):
            break
        entry = _cheaper(entry, _solve(case, data, solver_entry, out))
    return entry


def _solve(case: Case, data: Dataset, solver_entry: SolverEntry, out: Path) -> Entry:
    """Solve and score, in CPU seconds: other processes only make a solver wait."""
    try:
        # like the reference kernel; other processes slow threads down most
        reference_s = solve_timed(solver_entry, data, out, threads=1, clock=time.thread_time)
        share = open_result(out, data).cpu_share
        scores = _figures(case, out) if isinstance(case, RecordedCase) else score(data, out)
    except InputError as error:
        return Entry(error=str(error))
    kept = {
        key: value
        for key, value in scores.items()
        if key != _COMPILE
        and (value is None or (isinstance(value, int | float) and not isinstance(value, bool)))
    }
    if share is not None:
        kept |= {key: value * share for key in TIMES if (value := kept.get(key)) is not None}
    return Entry(figures=kept, reference_s=reference_s)


def _figures(case: RecordedCase, out: Path) -> dict[str, Any]:
    """Judge a result without truth; figures have names of their own."""
    scores = judge(case, out).scores
    found = scores["quality"]["figures"] if scores["quality"] else {}
    return scores | {f"{QUALITY}{key}": value for key, value in found.items()}


def _exceeds_tolerance(earlier: Entry, entry: Entry, tolerances: Tolerances, task: str) -> bool:
    """Decide whether time or memory would fail the gate.

    The reason may be another process, or machine code that was compiled for the first time.
    """
    now = scale_times(entry, earlier).figures
    pairs = [
        (key, old, new)
        for key in COSTS
        if (old := earlier.figures.get(key)) is not None and (new := now.get(key)) is not None
    ]
    return any(
        new - old > tolerance_of(tolerances, task, key).allowed(old) for key, old, new in pairs
    )


def _cheaper(one: Entry, other: Entry) -> Entry:
    """Combine the second run with the least time and memory of both runs.

    Times are scaled by the reference kernel.
    """
    if other.error or one.error:
        return other if other.error else one
    here = scale_times(one, other)
    least = {
        key: min(a, b)
        for key in COSTS
        if (a := here.figures.get(key)) is not None and (b := other.figures.get(key)) is not None
    }
    return other.model_copy(update={"figures": other.figures | least})
