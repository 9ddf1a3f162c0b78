"""Regression gates: run a suite again and compare it with a baseline."""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from sabench.dataset.reader import Dataset
from sabench.evaluation.gates.baseline import (
    COSTS,
    DATA,
    Baseline,
    CaseEntry,
    Entry,
    Tolerance,
    Tolerances,
    default_path,
    default_tolerance,
    kind_of,
    read_baseline,
    tolerance_of,
    write_baseline,
)
from sabench.evaluation.gates.dataset_statistics import fingerprint
from sabench.evaluation.gates.findings import Finding, compare, scaled
from sabench.evaluation.gates.known_wrong_estimates import score_known_wrong
from sabench.evaluation.runner import dataset_of, machine, solve_apart, versions
from sabench.evaluation.suites import Case, Entrant, load_suite
from sabench.scenes import find
from sabench.tasks.solve_and_score import score
from sabench.utils.errors import InputError
from sabench.utils.progress import console
from sabench.utils.version import __version__

_AGAIN = 2  # repetitions for a solver that seems to have become slower


@dataclass(frozen=True)
class Report:
    """Result of a gate.

    `worse` makes it fail, `news` does not; `now` is the baseline that this run would make.
    """

    suite: str
    worse: tuple[Finding, ...]
    news: tuple[Finding, ...]
    now: Baseline

    @property
    def summary(self) -> str:
        """Summary in one line."""
        solved = sum(len(case.solvers) for case in self.now.cases)
        ran = f"{self.suite}: {len(self.now.cases)} data sets, {solved} results"
        return (
            f"{ran}: {len(self.worse)} figures worse" if self.worse else f"{ran}: nothing got worse"
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to values that JSON can hold."""
        findings = {
            name: [asdict(one) | {"change": one.change} for one in getattr(self, name)]
            for name in ("worse", "news")
        }
        return {"suite": self.suite, **findings, "figures": self.now.model_dump(mode="json")}


def check_file(
    suite: str | Path,
    path: Path | None,
    work: Path | None,
    *,
    update: bool = False,
    solvers: Sequence[str | Entrant] = (),
    exit_first: bool = False,
) -> Report:
    """Compare a suite with a baseline file, as `check` does.

    The default is the suite's bundled baseline. With `update` the new figures are written to the
    file, and nothing counts as worse.

    Parameters
    ----------
    work : by default a temporary folder.
    solvers : names, or names with parameters.

    Raises
    ------
    InputError
        As `check` and `read_baseline`.
    """
    name = find(suite, "scenes/suites").stem
    file = path or default_path(name)
    before = read_baseline(file, name) if file.exists() or not update else None
    entrants = [Entrant(name=one) if isinstance(one, str) else one for one in solvers]
    with contextlib.ExitStack() as stack:
        folder = work or Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="sabench-check-"))
        )
        report = check(
            suite, before, folder, solvers=entrants, exit_first=exit_first and not update
        )
    if not update:
        return report
    write_baseline(file, report.now)
    return replace(report, worse=(), news=report.worse + report.news)


def check(
    suite: str | Path,
    before: Baseline | None,
    work: Path,
    *,
    solvers: Sequence[Entrant] = (),
    exit_first: bool = False,
) -> Report:
    """Run a suite on new data sets and compare it with a baseline, if there is one.

    Parameters
    ----------
    work : folder for data sets and results; each data set is deleted after its comparison.
    solvers : they run in place of the suite's own, each on the cases that have solvers of its task.
        The baseline must be of the same solvers.
    exit_first : stop at the first data set or solver with something worse.

    Raises
    ------
    InputError
        A bad suite, an unknown solver, solvers without any case for their task, or a baseline whose
        data sets another renderer made.
    """
    name, cases = find(suite, "scenes/suites").stem, _chosen(load_suite(suite)[1], solvers)
    found: list[Finding] = []
    entries = []
    for number, case in enumerate(cases, 1):
        console.print(
            f"data set {number} of {len(cases)}: {case.name}, seed {case.seed}",
            markup=False,
            highlight=False,
        )
        old = before.case((case.name, case.seed)) if before else None
        if old is not None and old.renderer != case.renderer:
            raise InputError(
                f"case {case.name}: expected data sets by {old.renderer}, of which the baseline "
                f"is, but here they are by {case.renderer}"
            )
        entries.append(_run_case(case, work, old, before.tolerances if before else {}, exit_first))
        found += _compared(case, old, entries[-1], before)
        if exit_first and any(finding.worse for finding in found):
            break
    else:
        found += _missing(before, entries)
    now = Baseline(
        suite=name,
        sabench=__version__,
        machine=machine(),
        versions=versions(),
        tolerances=_tolerances(before, cases, entries),
        cases=tuple(entries),
    )
    return Report(
        name,
        tuple(one for one in found if one.worse),
        tuple(one for one in found if not one.worse),
        now,
    )


def names_of(entrants: Sequence[Entrant], where: str) -> dict[str, Entrant]:
    """Name each solver of a case: by its label, or its name and parameters."""
    named = {
        (
            one.label
            or " ".join([one.name, *(f"{k}={json.dumps(v)}" for k, v in one.parameters.items())])
        ): one
        for one in entrants
    }
    if len(named) < len(entrants):
        raise InputError(
            f"{where}: solvers: expected names, parameters or labels that differ, got "
            f"{len(entrants)} of which {len(named)} do"
        )
    return named


def _chosen(cases: Sequence[Case], solvers: Sequence[Entrant]) -> list[Case]:
    """Select the cases that have solvers of the given solvers' tasks.

    They run the given solvers instead of their own. Without given solvers, all cases stay as they
    are.
    """
    if not solvers:
        return list(cases)
    own = [
        replace(
            case,
            solvers=tuple(
                one
                for one in solvers
                if _task_of(one) in {_task_of(other) for other in case.solvers}
            ),
        )
        for case in cases
    ]
    if not any(case.solvers for case in own):
        known = ", ".join(sorted({_task_of(one) for one in solvers}))
        raise InputError(
            "solvers: expected some that the suite has cases for, got only some of the task "
            f"{known}, of which it has none"
        )
    return [case for case in own if case.solvers]


def _task_of(entrant: Entrant) -> str:
    return entrant.describe()[1]


def _run_case(
    case: Case, work: Path, old: CaseEntry | None, tolerances: Tolerances, exit_first: bool
) -> CaseEntry:
    """Make a data set, measure its statistics, and solve and score it.

    With `exit_first` it stops as soon as something is worse.
    """
    data = dataset_of(case, work, fresh=True)
    out = work / "results" / f"{case.folder(work).name}.h5"
    now = CaseEntry(
        case=case.name,
        seed=case.seed,
        renderer=case.renderer,
        scene_hash=case.scene.hash,
        data={},
        solvers={},
    )
    now = now.model_copy(update={"data": {**fingerprint(data), **score_known_wrong(data, out)}})
    for name, entrant in names_of(case.solvers, f"case {case.name}").items():
        if (
            exit_first
            and old
            and any(
                finding.worse
                for finding in compare(_ran(old, now), now, _tasks_of(case), tolerances)
            )
        ):
            break
        entry = _solved_again(
            data, entrant, out, old.solvers.get(name) if old else None, tolerances
        )
        now = now.model_copy(update={"solvers": {**now.solvers, name: entry}})
    shutil.rmtree(data.root)
    out.unlink(missing_ok=True)
    return now


def _ran(old: CaseEntry, now: CaseEntry) -> CaseEntry:
    """Remove the solvers that have not run now from the old entry."""
    return old.model_copy(
        update={
            "solvers": {name: entry for name, entry in old.solvers.items() if name in now.solvers}
        }
    )


def _tasks_of(case: Case) -> dict[str, str]:
    return {
        name: _task_of(entrant)
        for name, entrant in names_of(case.solvers, f"case {case.name}").items()
    }


def _solved_again(
    data: Dataset, entrant: Entrant, out: Path, earlier: Entry | None, tolerances: Tolerances
) -> Entry:
    """Solve and score; repeat where time or memory seem to have grown."""
    entry = _solved(data, entrant, out)
    for _ in range(_AGAIN):
        if earlier is None or not _dear(earlier, entry, tolerances, _task_of(entrant)):
            break
        entry = _cheaper(entry, _solved(data, entrant, out))
    return entry


def _solved(data: Dataset, entrant: Entrant, out: Path) -> Entry:
    try:
        # like the reference kernel; other processes slow threads down most
        reference_s = solve_apart(entrant, data, out, threads=1)
        scores = score(data, out)
    except InputError as error:
        return Entry(error=str(error))
    kept = {
        key: value
        for key, value in scores.items()
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    }
    return Entry(figures=kept, reference_s=reference_s)


def _dear(earlier: Entry, entry: Entry, tolerances: Tolerances, task: str) -> bool:
    """Decide whether time or memory would fail the gate.

    The reason may be another process, or machine code that was compiled for the first time.
    """
    now = scaled(entry, earlier).figures
    pairs = [
        (key, old, new)
        for key in COSTS
        if (old := earlier.figures.get(key)) is not None and (new := now.get(key)) is not None
    ]
    return any(new - old > tolerance_of(tolerances, task, key).of(old) for key, old, new in pairs)


def _cheaper(one: Entry, other: Entry) -> Entry:
    """Combine the second run with the least time and memory of both runs.

    Times are scaled by the reference kernel.
    """
    if other.error or one.error:
        return other if other.error else one
    here = scaled(one, other)
    least = {
        key: min(a, b)
        for key in COSTS
        if (a := here.figures.get(key)) is not None and (b := other.figures.get(key)) is not None
    }
    return other.model_copy(update={"figures": other.figures | least})


def _compared(
    case: Case, old: CaseEntry | None, now: CaseEntry, before: Baseline | None
) -> Iterator[Finding]:
    if before is None:
        return
    if old is None:
        yield Finding(
            *now.key,
            DATA,
            "",
            None,
            None,
            None,
            worse=False,
            text="a case that is not in the baseline",
        )
        return
    if old.scene_hash != now.scene_hash:
        yield Finding(
            *now.key,
            DATA,
            "scene",
            None,
            None,
            None,
            worse=True,
            text="its scene is not the one of the baseline",
        )
    cut_short = len(now.solvers) < len(case.solvers)
    yield from compare(
        _ran(old, now) if cut_short else old, now, _tasks_of(case), before.tolerances
    )


def _missing(before: Baseline | None, entries: Sequence[CaseEntry]) -> Iterator[Finding]:
    there = {entry.key for entry in entries}
    for case in before.cases if before else ():
        if case.key not in there:
            yield Finding(
                *case.key,
                DATA,
                "",
                None,
                None,
                None,
                worse=True,
                text="a case of the baseline that did not run",
            )


def _tolerances(
    before: Baseline | None, cases: Sequence[Case], entries: Sequence[CaseEntry]
) -> dict[str, dict[str, Tolerance]]:
    """List the tolerances of the next baseline.

    They are those of the earlier baseline, which may have been edited, and the rule's for all other
    figures.
    """
    named: dict[str, set[str]] = {
        DATA: {kind_of(DATA, figure) for entry in entries for figure in entry.data}
    }
    for case, entry in zip(cases, entries, strict=False):
        for name, task in _tasks_of(case).items():
            named.setdefault(task, set()).update(
                entry.solvers[name].figures if name in entry.solvers else ()
            )
    made = {
        task: {key: default_tolerance(task, key) for key in figures}
        for task, figures in named.items()
    }
    earlier = before.tolerances if before else {}
    return {task: made.get(task, {}) | earlier.get(task, {}) for task in {**made, **earlier}}
