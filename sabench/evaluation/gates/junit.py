"""Reports of gates as JUnit XML, which GitHub, GitLab and Jenkins show."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from sabench.evaluation.gates.baseline import DATA, CaseEntry
from sabench.evaluation.gates.findings import Finding
from sabench.utils.files import complete_or_nothing

if TYPE_CHECKING:
    from sabench.evaluation.gates.comparison import Report

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
