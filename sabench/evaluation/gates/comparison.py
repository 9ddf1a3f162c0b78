"""Regression gates: run a suite again and compare it with a baseline.

A case has the statistics of its data set and the figures of its solvers. Estimates that are wrong
in a known way are scored too: a bug in a metric that flatters every solver shows in their scores.
Reports can be written as JUnit XML, which GitHub, GitLab and Jenkins show.
"""

import contextlib
import json
import re
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sabench import tasks
from sabench.dataset.reader import Dataset
from sabench.dataset.results import open_result, result_writer
from sabench.evaluation.gates.baseline import (
    COMPARED_COSTS,
    DATA,
    QUALITY,
    TIMES,
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
from sabench.evaluation.gates.findings import Finding, compare, scale_times
from sabench.evaluation.records import machine, versions
from sabench.evaluation.runner import dataset_of, discard
from sabench.evaluation.suite_loading import judge, load_suite
from sabench.evaluation.suites import Case, RecordedCase, SolverEntry
from sabench.evaluation.timed_solving import solve_timed
from sabench.scenes import find
from sabench.tasks.external_programs import solver_name
from sabench.tasks.solve_and_score import score
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.number_text import significant
from sabench.utils.progress import say
from sabench.utils.version import __version__


def score_known_wrong(data: Dataset, out: Path) -> dict[str, float]:
    """Score the wrong estimates of all tasks that a data set serves.

    Temporary results are written to `out`.

    Returns scores by names like `probe.reconstruction.q`.
    """
    figures: dict[str, float] = {}
    for task in tasks.every():
        if not task.accepts(data):
            continue
        with result_writer(out, data, "probe", task.name, {}, overwrite=True) as writer:
            for frame in task.frames(data):
                writer.add(task.wrong(data, frame), frame)
        scores = score(data, out)
        figures |= {
            f"probe.{task.name}.{column.key}": float(value)
            for column in task.all_scores
            if (value := scores.get(column.key)) is not None
        }
    return figures


_AGAIN = 2  # repetitions for a solver that seems to have become slower
_COMPILE = "compile_s"  # depends on what the cache holds, and on nothing that a gate is about


def names_of(solver_entries: Sequence[SolverEntry], where: str) -> dict[str, SolverEntry]:
    """Name each solver of a case: by its label, or its name and parameters."""
    named: dict[str, SolverEntry] = {}
    for entry in solver_entries:
        pairs = [f"{k}={json.dumps(v)}" for k, v in entry.parameters.items()]
        # a program's file name, which is the same on other machines
        named[entry.label or " ".join([solver_name(entry.name), *pairs])] = entry
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
        data=fingerprint(data) | score_known_wrong(data, out) if data.has_truth else {},
        solvers={},
    )
    for name, solver_entry in names_of(case.solvers, f"case {case.name}").items():
        if exit_first and old:
            found = compare(drop_not_run(old, now), now, tasks_of(case), tolerances)
            if any(finding.worse for finding in found):
                break
        earlier = old.solvers.get(name) if old else None
        entry = _solve_again(case, data, solver_entry, out, earlier, tolerances)
        first = tasks.of(task_of(solver_entry)).columns[:3]
        scores = [f"{score.key} {significant(entry.figures.get(score.key))}" for score in first]
        say(f"{name}: {entry.error or ', '.join(scores)}")
        now = now.model_copy(update={"solvers": {**now.solvers, name: entry}})
    discard(case, data)
    out.unlink(missing_ok=True)
    return now


def drop_not_run(old: CaseEntry, now: CaseEntry) -> CaseEntry:
    """Remove the solvers that have not run now from the old entry."""
    ran = {name: entry for name, entry in old.solvers.items() if name in now.solvers}
    return old.model_copy(update={"solvers": ran})


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
        task = task_of(solver_entry)
        if earlier is None or not _exceeds_tolerance(earlier, entry, tolerances, task):
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
    figures = {
        key: value
        for key, value in scores.items()
        if key != _COMPILE
        and (value is None or (isinstance(value, int | float) and not isinstance(value, bool)))
    }
    if share is not None:
        figures |= {key: value * share for key in TIMES if (value := figures.get(key)) is not None}
    return Entry(figures=figures, reference_s=reference_s)


def _figures(case: RecordedCase, out: Path) -> dict[str, Any]:
    """Score a result without truth; the figures have separate names."""
    scores = judge(case, out).scores
    figures = scores["quality"]["figures"] if scores["quality"] else {}
    return scores | {f"{QUALITY}{key}": value for key, value in figures.items()}


def _exceeds_tolerance(earlier: Entry, entry: Entry, tolerances: Tolerances, task: str) -> bool:
    """Decide whether time or memory would fail the gate.

    The reason may be another process, or machine code that was compiled for the first time.
    """
    now = scale_times(entry, earlier).figures
    pairs = [
        (key, old, new)
        for key in COMPARED_COSTS
        if (old := earlier.figures.get(key)) is not None and (new := now.get(key)) is not None
    ]
    return any(
        new - old > tolerance_of(tolerances, task, key).allowed(old) for key, old, new in pairs
    )


def _cheaper(first: Entry, other: Entry) -> Entry:
    """Combine the second run with the least time and memory of both runs.

    Times are scaled by the reference kernel.
    """
    if other.error or first.error:
        return other if other.error else first
    here = scale_times(first, other)
    least = {
        key: min(a, b)
        for key in COMPARED_COSTS
        if (a := here.figures.get(key)) is not None and (b := other.figures.get(key)) is not None
    }
    return other.model_copy(update={"figures": other.figures | least})


@dataclass(frozen=True)
class GateReport:
    """Result of a gate.

    `worse` makes it fail, `news` does not; `now` is the baseline that this run would make, and
    `written` the file that it was written to.
    """

    suite: str
    worse: tuple[Finding, ...]
    news: tuple[Finding, ...]
    now: Baseline
    written: Path | None = None

    @property
    def summary(self) -> str:
        """Summary in one line."""
        solved = sum(len(case.solvers) for case in self.now.cases)
        ran = f"{self.suite}: {len(self.now.cases)} data sets, {solved} results"
        if self.written:
            return f"{ran}: baseline written to {self.written}"
        return (
            f"{ran}: {len(self.worse)} figures worse" if self.worse else f"{ran}: nothing got worse"
        )

    def to_dict(self) -> dict[str, Any]:
        """Convert to values that JSON can hold."""
        findings = {
            name: [asdict(finding) | {"change": finding.change} for finding in getattr(self, name)]
            for name in ("worse", "news")
        }
        return {"suite": self.suite, **findings, "figures": self.now.model_dump(mode="json")}


def check(
    suite: str | Path,
    path: Path | None,
    work: Path | None,
    *,
    update: bool = False,
    solvers: Sequence[str | SolverEntry] = (),
    exit_first: bool = False,
) -> GateReport:
    """Compare a suite with a baseline file.

    The default is the suite's bundled baseline, or SUITE.baseline.json next to a suite of one's
    own. With `update` the new figures are written to the file, and nothing counts as worse.

    Parameters
    ----------
    work : by default a temporary folder.
    solvers : names, or names with parameters.

    Raises InputError: a bad suite, an unknown solver, solvers without any case for their task, or a
    baseline that is broken or whose data sets another renderer made.
    """
    source = find(suite, "scenes/suites")
    name, file = source.stem, path or default_path(source)
    before = read_baseline(file, name) if file.exists() or not update else None
    given = [SolverEntry(name=solver) if isinstance(solver, str) else solver for solver in solvers]
    with contextlib.ExitStack() as stack:
        folder = work or Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="sabench-check-"))
        )
        report = _compare_suite(suite, before, folder, given, exit_first and not update)
    if not update:
        return report
    write_baseline(file, report.now)
    return replace(report, worse=(), news=report.worse + report.news, written=file)


def _compare_suite(
    suite: str | Path,
    before: Baseline | None,
    work: Path,
    solvers: Sequence[SolverEntry],
    exit_first: bool,
) -> GateReport:
    """Run a suite on new data sets and compare it with a baseline, if there is one.

    Each data set is deleted after its comparison. Given solvers run in place of the suite's own,
    each on the cases that have solvers of its task.
    """
    name, cases = find(suite, "scenes/suites").stem, _select_cases(load_suite(suite)[1], solvers)
    findings: list[Finding] = []
    entries = []
    for number, case in enumerate(cases, 1):
        say(f"data set {number} of {len(cases)}: {case.name}, {case.words}")
        old = before.case((case.name, case.seed)) if before else None
        if old is not None and old.renderer != case.renderer:
            raise InputError(
                f"case {case.name}: expected data sets by {old.renderer}, of which the baseline "
                f"is, but here they are by {case.renderer}"
            )
        entries.append(run_case(case, work, old, before.tolerances if before else {}, exit_first))
        findings += _compare(case, old, entries[-1], before)
        if exit_first and any(finding.worse for finding in findings):
            break
    else:
        findings += _missing(before, entries)
    now = Baseline(
        suite=name,
        sabench=__version__,
        machine=machine(),
        versions=versions(),
        tolerances=_tolerances(before, cases, entries),
        cases=tuple(entries),
    )
    return GateReport(
        name,
        tuple(finding for finding in findings if finding.worse),
        tuple(finding for finding in findings if not finding.worse),
        now,
    )


def _select_cases(cases: Sequence[Case], solvers: Sequence[SolverEntry]) -> list[Case]:
    """Select the cases that have solvers of the given solvers' tasks.

    They run the given solvers instead of those of the suite. Without given solvers, all cases stay
    as they are.
    """
    if not solvers:
        return list(cases)
    selected = [
        replace(
            case,
            solvers=tuple(
                solver for solver in solvers if task_of(solver) in {*map(task_of, case.solvers)}
            ),
        )
        for case in cases
    ]
    if not any(case.solvers for case in selected):
        given = ", ".join(sorted({task_of(solver) for solver in solvers}))
        raise InputError(
            "solvers: expected some that the suite has cases for, got only some of the task "
            f"{given}, of which it has none"
        )
    return [case for case in selected if case.solvers]


def _compare(
    case: Case, old: CaseEntry | None, now: CaseEntry, before: Baseline | None
) -> Iterator[Finding]:
    if before is None:
        return
    if old is None:
        yield Finding(*now.key, DATA, worse=False, text="a case that is not in the baseline")
        return
    if old.scene_hash != now.scene_hash:
        what = "recording" if isinstance(case, RecordedCase) else "scene"
        text = f"its {what} is not the one of the baseline"
        yield Finding(*now.key, DATA, "scene", worse=True, text=text)
    cut_short = len(now.solvers) < len(case.solvers)
    yield from compare(
        drop_not_run(old, now) if cut_short else old, now, tasks_of(case), before.tolerances
    )


def _missing(before: Baseline | None, entries: Sequence[CaseEntry]) -> Iterator[Finding]:
    keys = {entry.key for entry in entries}
    for case in before.cases if before else ():
        if case.key not in keys:
            text = "a case of the baseline that did not run"
            yield Finding(*case.key, DATA, worse=True, text=text)


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
        for name, task in tasks_of(case).items():
            named.setdefault(task, set()).update(
                entry.solvers[name].figures if name in entry.solvers else ()
            )
    default = {
        task: {key: default_tolerance(task, key) for key in figures}
        for task, figures in named.items()
    }
    earlier = before.tolerances if before else {}
    return {task: default.get(task, {}) | earlier.get(task, {}) for task in {**default, **earlier}}


_Place = tuple[str, int, str]  # case, seed and solver
# characters that XML does not allow
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(path: Path, report: GateReport) -> None:
    """Write one test case for each data set and each solver on it.

    They are in the suite's order. Everything that got worse is a failure, news are output.
    """
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_bytes(
            ElementTree.tostring(junit(report), encoding="utf-8", xml_declaration=True)
        )


def junit(report: GateReport) -> ElementTree.Element:
    """Build the root element of the XML."""
    root = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(root, "testsuite", name=f"sabench check {report.suite}")
    seconds: dict[_Place, float] = {}
    for case in report.now.cases:
        seconds[*case.key, DATA] = 0.0
        for solver, entry in case.solvers.items():
            seconds[*case.key, solver] = entry.figures.get("seconds") or 0.0
    worse, news = _sentences(report.worse), _sentences(report.news)
    for place in {**seconds, **worse}:
        name, seed, solver = place
        group = f"{report.suite}.{name}.seed{seed}"
        node = ElementTree.SubElement(suite, "testcase", classname=group, name=_clean(solver))
        node.set("time", f"{seconds.get(place, 0.0):.3f}")
        if said := worse.get(place):
            failure = ElementTree.SubElement(node, "failure", message=said[0], type="regression")
            failure.text = "\n".join(said)
        if place in news:
            ElementTree.SubElement(node, "system-out").text = "\n".join(news[place])
    counts = {
        "tests": str(len(suite)),
        "failures": str(len(worse)),
        "errors": "0",
        "skipped": "0",
        "time": f"{sum(seconds.values()):.3f}",
    }
    suite.attrib.update(counts)
    root.attrib.update(counts | {"name": "sabench"})
    return root


def _sentences(findings: Iterable[Finding]) -> dict[_Place, list[str]]:
    """Group sentences by case, seed and solver."""
    found: dict[_Place, list[str]] = {}
    for one in findings:
        found.setdefault((one.case, one.seed, one.solver), []).append(_clean(one.sentence))
    return found


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
