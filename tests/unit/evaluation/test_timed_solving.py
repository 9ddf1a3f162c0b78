"""Processes in which solvers are timed: what their server has loaded, they need not load."""

from __future__ import annotations

import sys

import sabench.evaluation.timed_solving  # noqa: F401 - names what the server loads
from sabench import tasks
from sabench.utils.processes.call import call_isolated


def loaded() -> list[str]:
    return [name for name in sys.modules if name.startswith(("sabench.tasks.", "numba.np."))]


def test_a_solver_s_process_has_all_tasks_and_the_compiler_from_its_server() -> None:
    names = call_isolated(loaded, doing="look")
    assert {f"sabench.tasks.{name}" for name in tasks.NAMES} <= set(names)
    assert "numba.np.npyimpl" in names
