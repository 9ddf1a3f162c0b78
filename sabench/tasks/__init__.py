"""Tasks: one module and one object for each, found by its name."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, get_args

from sabench.api.solvers import TaskName
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from sabench.dataset.reader import Dataset
    from sabench.tasks.task import Task

NAMES: tuple[TaskName, ...] = get_args(TaskName)


def of(name: str) -> Task:
    """Import the task of this name."""
    task: Task = importlib.import_module(f"{__name__}.{name}").TASK
    return task


def every() -> list[Task]:
    """Import all tasks, in the order of the leaderboard."""
    return [of(name) for name in NAMES]


def check_task(name: TaskName, data: Dataset, path: Path) -> None:
    """Raise an InputError for a result of a task that a data set cannot score."""
    if not of(name).scores_data(data):
        possible = " or ".join(task.name for task in every() if task.scores_data(data))
        raise InputError(
            f"{path}: attribute task: expected {possible}, which {data.root} can score, got {name}"
        )


def of_data(data: Dataset, asked: str | None = None) -> Task:
    """Choose the task that a data set is scored by.

    It is the one that `asked` names, or the first task for the kind of objects that the data set
    shows last.

    Raises InputError for a task that the data set cannot serve.
    """
    possible = [task for task in every() if task.accepts(data)]
    default = next(task for task in possible if task.shown == data.shows[-1])
    chosen = next((task for task in possible if task.name == asked), None) if asked else default
    if chosen is None:
        names = " or ".join(task.name for task in possible)
        raise InputError(f"task: expected {names} for {data.root}, got {asked!r}")
    return chosen
