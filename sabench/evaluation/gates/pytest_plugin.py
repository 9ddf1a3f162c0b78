"""Plug-in of pytest for repositories of algorithms.

The fixture `sabench_check` runs a suite with their solvers and compares it with their baseline.

pytest imports this at its start, so it loads nothing of sabench before a test asks for the fixture.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from sabench.evaluation.gates.comparison import GateReport

Check = Callable[..., "GateReport"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option --sabench-update and the setting sabench_plugins."""
    group = parser.getgroup("sabench")
    group.addoption(
        "--sabench-update",
        action="store_true",
        help="write the figures of sabench_check as new baselines instead of comparing",
    )
    parser.addini(
        "sabench_plugins",
        "folders with solvers/ or generators/, in addition to those of SABENCH_PLUGINS",
        type="paths",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Add the folders of plug-ins to the environment of sabench and its solvers."""
    folders = [str(folder) for folder in config.getini("sabench_plugins")]
    given = [
        entry
        for entry in os.environ.get("SABENCH_PLUGINS", "").split(os.pathsep)
        if entry and entry not in folders
    ]
    if not folders:
        return
    os.environ["SABENCH_PLUGINS"] = os.pathsep.join([*folders, *given])
    if "sabench.plugins" in sys.modules:
        sys.modules["sabench.plugins"].mount()


@pytest.fixture
def sabench_check(request: pytest.FixtureRequest, tmp_path: Path) -> Check:
    """Return `sabench_check(suite, baseline, solvers=...)`, which runs a gate.

    It fails the test if a figure is worse than in the baseline, and returns the report.

    `suite` is a bundled suite's name or a file, `baseline` a JSON file, both from the test's
    folder; `solvers` are names, or dicts of name, parameters and label, that run in place of the
    suite's own on its cases of their task. With --sabench-update the baseline is written.
    """

    def run(
        suite: str, baseline: str | Path, solvers: Sequence[str | Mapping[str, Any]] = ()
    ) -> GateReport:
        from sabench.evaluation.gates.comparison import check as compare
        from sabench.evaluation.suites import SolverEntry
        from sabench.utils.errors import InputError

        here = request.path.parent
        solver_entries = [
            SolverEntry(name=solver) if isinstance(solver, str) else SolverEntry(**solver)
            for solver in solvers
        ]
        where = here / suite if (here / suite).is_file() else suite
        update = bool(request.config.getoption("--sabench-update"))
        try:
            report = compare(
                where, here / baseline, tmp_path / "sabench", update=update, solvers=solver_entries
            )
        except InputError as error:
            report, fault = None, str(error)
        if report is None:  # a sentence that needs no traceback
            pytest.fail(fault, pytrace=False)
        if report.worse:
            lines = [report.summary, *(finding.sentence for finding in report.worse)]
            pytest.fail("\n".join(lines), pytrace=False)
        return report

    return run


@pytest.fixture
def sabench_conform() -> Callable[..., None]:
    """Return `sabench_conform(solver, **parameters)`, which runs conformance tests.

    It fails the test if a law is broken.
    """

    def run(solver: str, **parameters: Any) -> None:
        from sabench.tasks.conformance import check_solver

        broken = [check for check in check_solver(solver, parameters) if check.verdict == "broken"]
        if broken:
            lines = [f"solver {solver} breaks {len(broken)} laws:"]
            lines += [f"{check.law}: {check.text}" for check in broken]
            pytest.fail("\n".join(lines), pytrace=False)

    return run
