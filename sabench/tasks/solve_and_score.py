"""Run a solver on the observation side of a data set, weigh what it cost, and score its result against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sabench import tasks
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, open_result, result_writer
from sabench.tasks.external_programs import is_program, run_program
from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.processes.limited import Limits

_SHOWN = {
    "particles": "particles",
    "target": "a calibration target",
    "bubbles": "bubbles",
    "code": "a code",
}
OWN_TRACK = {
    "particles": "reconstruction",
    "target": "calibration",
    "bubbles": "bubbles",
    "code": "see_through",
}  # of what a data set shows
ALSO = {"particles": ("particles",)}  # tracks that the words truth and empty may be scored by, too


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
        An unknown solver or parameter, a broken data set or one of another track, and what the
        track's `run` refuses.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    if is_program(solver):
        return run_program(
            solver, data, Path(out), parameters=parameters, limits=limits, overwrite=overwrite
        )
    if limits is not None:
        raise InputError(
            f"solver {solver}: expected limits for programs only, not for a plug-in, which runs within sabench"
        )
    algorithm = make_algorithm(solver, parameters or {})
    if algorithm.sees not in data.shows:
        shown = " and ".join(_SHOWN[one] for one in data.shows)
        raise InputError(
            f"solver {solver}: expected a data set that shows {_SHOWN[algorithm.sees]}, but {data.root} shows {shown}"
        )
    memory.forget_peak()
    resolved = algorithm.parameters.model_dump(mode="json")
    with result_writer(
        Path(out), data, solver, algorithm.track, resolved, overwrite=overwrite
    ) as writer:
        seconds = tasks.of(algorithm.track).run(algorithm, solver, data, writer)
        writer.set_cost(float(np.mean(seconds)), memory.peak_mb())
    return open_result(out, data)


def score(
    dataset: Dataset | str | Path, result: str | Path, track: str | None = None
) -> dict[str, Any]:
    """Score a result file, or one of the words `truth` and `empty`, the two ends of every scale.

    Parameters
    ----------
    track : by whose scores the words are scored, where a data set serves several: None for
        `OWN_TRACK`. A result says its own.

    Returns
    -------
    A flat dict: dataset, track, solver, parameters, the track's scores, seconds, peak_mb; None
    where a figure does not apply.

    Raises
    ------
    InputError
        A file that is not a result of this data set, or has a wrong shape or values that are not
        finite.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    opened = None if str(result) in ("truth", "empty") else open_result(result, data)
    track = _track(data, opened, track)
    head: dict[str, Any] = {
        "dataset": data.content_hash,
        "track": track,
        "solver": opened.solver if opened else str(result),
    }
    head |= {"parameters": opened.parameters if opened else {}}
    figures = tasks.of(track).score_result(data, opened or str(result))
    return {
        **head,
        **figures,
        "seconds": opened.seconds if opened else None,
        "peak_mb": opened.peak_mb if opened else None,
    }


def _track(data: Dataset, opened: Result | None, asked: str | None) -> str:
    """By whose scores a result or a word is scored."""
    allowed = (
        (opened.track,)
        if opened
        else tuple(dict.fromkeys((OWN_TRACK[data.shows[-1]], *ALSO.get(data.shows[-1], ()))))
    )
    if asked and asked not in allowed:
        raise InputError(
            f"track: expected {' or '.join(allowed)} for {opened.path if opened else data.root}, got {asked!r}"
        )
    return asked or allowed[0]
