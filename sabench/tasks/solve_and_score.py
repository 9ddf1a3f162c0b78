"""Runs of a solver on a data set's observation side, and scores of its result.

The time and memory of the solver are measured; the scores compare its result with the truth.
"""

import functools
import json
import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sabench import plugins, tasks
from sabench.api.make import make_algorithm
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import Result, add_identity, open_result, result_writer
from sabench.plotting.card import Card
from sabench.tasks import external_programs
from sabench.tasks.task import BETTER
from sabench.tasks.visible_files import open_sandbox, view_of_import, view_of_plugin
from sabench.utils import backend, memory
from sabench.utils.errors import InputError
from sabench.utils.files import check_replaceable, complete_or_nothing, refuse_existing
from sabench.utils.number_text import format_number
from sabench.utils.processes.call import call_isolated, preload
from sabench.utils.processes.confinement import can_confine
from sabench.utils.processes.program import ProgramLimits
from sabench.utils.progress import announce_compiling

preload(
    "sabench.tasks.solve_and_score",
    "sabench.algorithms.refocus",
    "sabench.algorithms.tomography.problem",
    # modules that solvers import while they solve, which would add to their run time
    "cv2",
    "sabench.geometry.cylinder_wall",
    "sabench.geometry.projection_kernels",
    "scipy.ndimage",
    "scipy.spatial",
    "scipy.special",
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
    limits: ProgramLimits | None = None,
    threads: int | None = None,
    iterations: bool = False,
    overwrite: bool = False,
) -> Result:
    """Run a solver on every frame of a data set and write its result file.

    It runs in a child process that holds the observation side alone. Where the system can confine
    a process, it sees no other file of the user, no other process, and no network.

    Raises InputError for an unknown solver or parameter, a broken data set or one of another task,
    and anything that the task's `run` refuses.

    Parameters
    ----------
    solver : its name, or the path of a program (docs/developing/participate.md).
    out : the result file to make.
    parameters : of the solver; the others keep their defaults.
    limits : of a program's time, memory and output.
    threads : of a plug-in's kernels and linear algebra; None: as many as there are cores.
    iterations : store the first frame's estimates on the way, too, of plug-ins that have them.
    overwrite : replace an existing result.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    check_replaceable(Path(out))
    if external_programs.is_program(solver):
        return external_programs.run_program(
            solver, data, Path(out), parameters=parameters, limits=limits, overwrite=overwrite
        )
    if limits is not None:
        raise InputError(
            f"solver {solver}: expected limits for programs only, not for a plug-in, which runs "
            "within sabench"
        )
    place, doing, parameters = Path(out), f"solver {solver}", parameters or {}
    refuse_existing(place, overwrite=overwrite)
    bundled = plugins.is_bundled("solvers", solver)  # raises where there is none
    task = "" if bundled else describe_solver(solver, parameters)[0]
    with open_sandbox(data) as sandbox, sandbox.naming(data.root, place):
        run = functools.partial(
            run_plug_in, threads=threads, isolated=sandbox.confined, iterations=iterations
        )
        call_isolated(
            run,
            solver,
            parameters,
            sandbox.observation,
            sandbox.result,
            doing=doing,
            view=view_of_plugin(sandbox, data, solver),
        )
        if bundled:
            with complete_or_nothing(place, overwrite=overwrite) as partial:
                shutil.move(sandbox.result, partial)
                add_identity(partial, data)
        else:
            result = external_programs.open_foreign(sandbox.result, data, solver)
            check_result_task(result.task, task, doing)
            confined = sandbox.confined
            head = replace(result, solver=solver, isolated=confined, whole_process=False)
            external_programs.copy_isolated(result, data, place, head, solver, overwrite=overwrite)
    return open_result(out, data)


def describe_solver(solver: str, parameters: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the task of a plug-in, and all its parameters with their defaults.

    One that is not sabench's own is imported in a child process, which is confined where that can
    be.
    """
    if plugins.is_bundled("solvers", solver):
        return _describe(solver, parameters)
    view = view_of_import(solver) if can_confine() else None
    doing = f"solver {solver}"
    task, resolved = call_isolated(_describe, solver, parameters, doing=doing, view=view)
    return task, resolved


def check_result_task(found: str, expected: str, who: str) -> None:
    """Raise an InputError for a result of another task than its solver is known for."""
    if found != expected:
        raise InputError(f"{who}: expected a result of the task {expected}, got one of {found}")


def _describe(solver: str, parameters: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    algorithm = make_algorithm(solver, parameters)
    return algorithm.task, algorithm.parameters.model_dump(mode="json")


def run_plug_in(
    solver: str,
    parameters: dict[str, Any],
    observation: Path,
    out: Path,
    *,
    threads: int | None,
    isolated: bool,
    iterations: bool = False,
) -> None:
    """Run a plug-in on an observation side in a child process."""
    from sabench.utils.compiled import compile_s, load_registries  # numba takes half a second

    data = open_dataset(observation)
    algorithm = make_algorithm(solver, parameters)
    if algorithm.sees not in data.shows:
        shown = " and ".join(_SHOWN[kind] for kind in data.shows)
        raise InputError(
            f"solver {solver}: expected a data set that shows {_SHOWN[algorithm.sees]}, but "
            f"this one shows {shown}"
        )
    counts = json.loads(Path(__file__).with_name("kernels.json").read_text(encoding="utf-8"))
    announce_compiling(counts.get(solver))
    load_registries()  # which no solver's clock should see
    memory.forget_peak()
    resolved = algorithm.parameters.model_dump(mode="json")
    with (
        backend.limit_libraries(threads),
        result_writer(out, data, solver, algorithm.task, resolved) as writer,
    ):
        writer.keeps_iterations = iterations
        before, start, spent = compile_s(), time.perf_counter(), _cpu_s()
        seconds = tasks.of(algorithm.task).run(algorithm, solver, data, writer)
        share = (_cpu_s() - spent) / (time.perf_counter() - start)
        mean_s = float(np.mean(seconds))
        costs = {"seconds": mean_s, "peak_mb": memory.peak_mb(), "cpu_share": share}
        writer.set(**costs, compile_s=compile_s() - before, isolated=isolated)


def _cpu_s() -> float:
    """Read the CPU seconds of this process and of its children that have ended."""
    return sum(os.times()[:4])


class Scores(Card, dict[str, Any]):
    """Scores of a result by their keys, shown as a table with the main score first.

    A flat dict: dataset, task, solver, parameters, the task's scores and costs (`costs_of`); None
    where a score does not apply.
    """

    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield (f"{self['solver']}, {self['task']}, data set {self['dataset'][:12]}",)
        for one in tasks.of(self["task"]).columns:
            yield one.key, format_number(self[one.key], one.decimals), one.unit, BETTER[one.better]


def score(
    dataset: Dataset | str | Path, result: Result | str | Path, task: str | None = None
) -> Scores:
    """Score a result or its file, or the best or worst possible estimates.

    The words `truth` and `empty` mean the best and the worst possible estimates.

    Raises InputError for a data set without truth, or a file that is not a result of this data set,
    or has a wrong shape or values that are not finite.

    Parameters
    ----------
    task : task for scoring `truth` or `empty`, where a data set serves several. None: the first
        task for the kind of objects that the data set shows last. A result file has its own.
    """
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    _ = data.manifest  # raises where there is no truth
    result = result.path if isinstance(result, Result) else result
    word = next((name for name in WORDS if name == str(result)), None)
    if word is None and not Path(result).exists():
        raise InputError(f"{result}: expected a result file, or truth or empty, found no file")
    opened = None if word else open_result(result, data)
    if opened and task not in (None, opened.task):
        raise InputError(f"task: expected {opened.task} for {opened.path}, got {task!r}")
    if opened:
        tasks.check_task(opened.task, data, opened.path)
    judged = tasks.of(opened.task) if opened else tasks.of_data(data, task)
    return Scores(
        dataset=data.content_hash,
        task=judged.name,
        solver=opened.solver if opened else word,
        parameters=opened.parameters if opened else {},
        **judged.score(data, opened or word or "empty"),
        **costs_of(opened),
    )


def score_iterations(dataset: Dataset, result: Path) -> list[list[float]] | None:
    """Compute [iteration, seconds, first score] of a result's estimates on the way.

    None for a result without any.
    """
    opened = open_result(result, dataset)
    return tasks.of(opened.task).score_iterations(dataset, opened) or None


def costs_of(result: Result | None) -> dict[str, Any]:
    """List what a result cost, and how it was measured; None for no result."""
    names = ("seconds", "peak_mb", "compile_s", "isolated", "whole_process")
    return {name: getattr(result, name) if result else None for name in names}
