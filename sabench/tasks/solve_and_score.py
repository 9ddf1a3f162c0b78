"""Runs of a solver on a data set's observation side, and scores of its result.

The time and memory of the solver are measured; the scores compare its result with the truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from sabench import tasks
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result, result_writer
from sabench.tasks.external_programs import is_program, run_program
from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.processes.isolated import preload
from sabench.utils.processes.limited import Limits

preload(
    "sabench.tasks.solve_and_score",
    "sabench.algorithms.refocus",
    "sabench.algorithms.tomography.problem",
)

WORDS: tuple[Literal["truth", "empty"], ...] = ("truth", "empty")
_SHOWN = {
    "particles": "particles",
    "target": "a calibration target",
    "bubbles": "bubbles",
    "code": "a code",
}


def solve(
    solver: str,
    dataset: Dataset | str | Path,
    out: str | Path,
    *,
    parameters: dict[str, Any] | None = None,
    limits: Limits | None = None,
    overwrite: bool = False,
) -> Result:
    """Run a solver on every frame of a data set and write its result file.

    Parameters
    ----------
    solver : its name, or the path of a program (docs/developing/participate.md).
    out : the result file to make.
    parameters : of the solver; the others keep their defaults.
    limits : of a program's time, memory and output.
    overwrite : replace an existing result.

    Raises
    ------
    InputError
        An unknown solver or parameter, a broken data set or one of another task, and anything that
        the task's `run` refuses.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    if is_program(solver):
        return run_program(
            solver, data, Path(out), parameters=parameters, limits=limits, overwrite=overwrite
        )
    if limits is not None:
        raise InputError(
            f"solver {solver}: expected limits for programs only, not for a plug-in, which runs "
            "within sabench"
        )
    algorithm = make_algorithm(solver, parameters or {})
    if algorithm.sees not in data.shows:
        shown = " and ".join(_SHOWN[one] for one in data.shows)
        raise InputError(
            f"solver {solver}: expected a data set that shows {_SHOWN[algorithm.sees]}, but "
            f"{data.root} shows {shown}"
        )
    memory.forget_peak()
    resolved = algorithm.parameters.model_dump(mode="json")
    with result_writer(
        Path(out), data, solver, algorithm.task, resolved, overwrite=overwrite
    ) as writer:
        seconds = tasks.of(algorithm.task).run(algorithm, solver, data, writer)
        writer.set_cost(float(np.mean(seconds)), memory.peak_mb())
    return open_result(out, data)


def score(
    dataset: Dataset | str | Path, result: str | Path, task: str | None = None
) -> dict[str, Any]:
    """Score a result file, or the best or worst possible estimates.

    The words `truth` and `empty` stand for the best and the worst possible estimates.

    Parameters
    ----------
    task : task whose scores apply to `truth` or `empty`, where a data set serves several. None: the
        first task for the kind of objects that the data set shows. A result file has its own.

    Returns
    -------
    A flat dict: dataset, task, solver, parameters, the task's scores, seconds, peak_mb; None where
    a score does not apply.

    Raises
    ------
    InputError
        A file that is not a result of this data set, or has a wrong shape or values that are not
        finite.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    word: Literal["truth", "empty"] | None = next(
        (one for one in WORDS if one == str(result)), None
    )
    opened = None if word else open_result(result, data)
    if opened and task not in (None, opened.task):
        raise InputError(f"task: expected {opened.task} for {opened.path}, got {task!r}")
    if opened:
        tasks.check_task(opened.task, data, opened.path)
    judged = tasks.of(opened.task) if opened else tasks.of_data(data, task)
    return {
        "dataset": data.content_hash,
        "task": judged.name,
        "solver": opened.solver if opened else word,
        "parameters": opened.parameters if opened else {},
        **judged.score(data, opened or word or "empty"),
        "seconds": opened.seconds if opened else None,
        "peak_mb": opened.peak_mb if opened else None,
    }
