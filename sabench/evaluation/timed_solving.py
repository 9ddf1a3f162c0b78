"""Solvers in child processes, timed next to the reference kernel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
from threadpoolctl import threadpool_limits

from sabench.dataset.reader import Dataset
from sabench.evaluation.gates.reference_kernel import reference_s
from sabench.evaluation.suites import SolverEntry
from sabench.tasks.solve_and_score import solve
from sabench.utils.files import clear_abandoned
from sabench.utils.processes.isolated import call_isolated, preload

preload("sabench.evaluation.gates.reference_kernel")


def solve_apart(
    solver_entry: SolverEntry, dataset: Dataset, out: Path, *, threads: int | None = None
) -> float:
    """Solve in a child process, with memory and crashes of its own.

    Its faults become an InputError here.

    Parameters
    ----------
    threads : of compiled kernels and of linear algebra; None: as many as there are cores.

    Returns
    -------
    Seconds of the reference kernel, the mean of before and after.
    """
    try:
        if not solver_entry.is_program:
            return float(
                call_isolated(
                    _solve,
                    solver_entry.name,
                    solver_entry.parameters,
                    str(dataset.root),
                    str(out),
                    threads,
                    doing=f"solver {solver_entry.name}",
                )
            )
        before = reference_s()
        solve(
            solver_entry.name,
            dataset,
            out,
            parameters=solver_entry.parameters,
            limits=solver_entry.limits,
            overwrite=True,
        )
        return (before + reference_s()) / 2.0
    finally:
        clear_abandoned(out)


def _solve(
    name: str, parameters: dict[str, Any], dataset: str, out: str, threads: int | None
) -> float:
    if threads is not None:
        numba.set_num_threads(threads)
    with threadpool_limits(threads):
        before = reference_s()
        solve(name, dataset, out, parameters=parameters, overwrite=True)
        return (before + reference_s()) / 2.0
