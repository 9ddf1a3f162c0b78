"""Regression gates: run a suite again and compare it with a baseline.

Reports can be written as JUnit XML, which GitHub, GitLab and Jenkins show.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sabench.evaluation.gates.baseline import (
    DATA,
    Baseline,
    CaseEntry,
    Tolerance,
    default_path,
    default_tolerance,
    kind_of,
    read_baseline,
    write_baseline,
)
from sabench.evaluation.gates.findings import Finding, compare
from sabench.evaluation.gates.measurement import drop_not_run, run_case, task_of, tasks_of
from sabench.evaluation.records import machine, versions
from sabench.evaluation.suite_loading import load_suite
from sabench.evaluation.suites import Case, RecordedCase, SolverEntry
from sabench.scenes import find
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.progress import console
from sabench.utils.version import __version__


@dataclass(frozen=True)
class Report:
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
            name: [asdict(one) | {"change": one.change} for one in getattr(self, name)]
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
) -> Report:
    """Compare a suite with a baseline file.

    The default is the suite's bundled baseline, or SUITE.baseline.json next to a suite of one's
    own. With `update` the new figures are written to the file, and nothing counts as worse.

    Parameters
    ----------
    work : by default a temporary folder.
    solvers : names, or names with parameters.

    Raises
    ------
    InputError
        A bad suite, an unknown solver, solvers without any case for their task, or a baseline that
        is broken or whose data sets another renderer made.
    """
    source = find(suite, "scenes/suites")
    name, file = source.stem, path or default_path(source)
    before = read_baseline(file, name) if file.exists() or not update else None
    solver_entries = [SolverEntry(name=one) if isinstance(one, str) else one for one in solvers]
    with contextlib.ExitStack() as stack:
        folder = work or Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="sabench-check-"))
        )
        report = _compare_suite(
            suite, before, folder, solvers=solver_entries, exit_first=exit_first and not update
        )
    if not update:
        return report
    write_baseline(file, report.now)
    return replace(report, worse=(), news=report.worse + report.news, written=file)


def _compare_suite(
    suite: str | Path,
    before: Baseline | None,
    work: Path,
    *,
    solvers: Sequence[SolverEntry] = (),
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
    name, cases = find(suite, "scenes/suites").stem, _select_cases(load_suite(suite)[1], solvers)
    found: list[Finding] = []
    entries = []
    for number, case in enumerate(cases, 1):
        console.print(
            f"data set {number} of {len(cases)}: {case.name}, {case.words}",
            markup=False,
            highlight=False,
        )
        old = before.case((case.name, case.seed)) if before else None
        if old is not None and old.renderer != case.renderer:
            raise InputError(
                f"case {case.name}: expected data sets by {old.renderer}, of which the baseline "
                f"is, but here they are by {case.renderer}"
            )
        entries.append(run_case(case, work, old, before.tolerances if before else {}, exit_first))
        found += _compare(case, old, entries[-1], before)
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


def _select_cases(cases: Sequence[Case], solvers: Sequence[SolverEntry]) -> list[Case]:
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
                one for one in solvers if task_of(one) in {task_of(other) for other in case.solvers}
            ),
        )
        for case in cases
    ]
    if not any(case.solvers for case in own):
        known = ", ".join(sorted({task_of(one) for one in solvers}))
        raise InputError(
            "solvers: expected some that the suite has cases for, got only some of the task "
            f"{known}, of which it has none"
        )
    return [case for case in own if case.solvers]


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
    there = {entry.key for entry in entries}
    for case in before.cases if before else ():
        if case.key not in there:
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
    made = {
        task: {key: default_tolerance(task, key) for key in figures}
        for task, figures in named.items()
    }
    earlier = before.tolerances if before else {}
    return {task: made.get(task, {}) | earlier.get(task, {}) for task in {**made, **earlier}}


# characters that XML does not allow
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(path: Path, report: Report) -> None:
    """Write one test case for each data set and each solver on it.

    They are in the suite's order. Everything that got worse is a failure, news are output.
    """
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_bytes(
            ElementTree.tostring(junit(report), encoding="utf-8", xml_declaration=True)
        )


def junit(report: Report) -> ElementTree.Element:
    """Build the root element of the XML."""
    suite = ElementTree.Element("testsuite", name=f"sabench check {report.suite}")
    places = [
        (case.case, case.seed, solver)
        for case in report.now.cases
        for solver in (DATA, *case.solvers)
    ]
    lost = [place for one in report.worse if (place := _place(one)) not in places]
    seconds = {
        place: _seconds(case, place[2])
        for case in report.now.cases
        for place in places
        if place[:2] == case.key
    }
    for place in dict.fromkeys(places + lost):
        name, seed, solver = place
        case = ElementTree.SubElement(
            suite, "testcase", classname=f"{report.suite}.{name}.seed{seed}", name=_clean(solver)
        )
        case.set("time", f"{seconds.get(place, 0.0):.3f}")
        worse = [_clean(one.sentence) for one in report.worse if _place(one) == place]
        if worse:
            failure = ElementTree.SubElement(case, "failure", message=worse[0], type="regression")
            failure.text = "\n".join(worse)
        news = [_clean(one.sentence) for one in report.news if _place(one) == place]
        if news:
            ElementTree.SubElement(case, "system-out").text = "\n".join(news)
    failures = sum(case.find("failure") is not None for case in suite)
    counts = {
        "tests": str(len(suite)),
        "failures": str(failures),
        "errors": "0",
        "skipped": "0",
        "time": f"{sum(seconds.values()):.3f}",
    }
    suite.attrib.update(counts)
    root = ElementTree.Element("testsuites", counts | {"name": "sabench"})
    root.append(suite)
    return root


def _place(one: Finding) -> tuple[str, int, str]:
    return one.case, one.seed, one.solver


def _seconds(case: CaseEntry, solver: str) -> float:
    entry = case.solvers.get(solver)
    return (entry.figures.get("seconds") if entry else None) or 0.0


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
