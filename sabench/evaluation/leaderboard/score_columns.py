"""Tables of the leaderboard: rows of one table have the same columns.

Results of recorded data sets have tables of their own, without scores and without ranks.
"""

from __future__ import annotations

from typing import NamedTuple

from sabench import tasks
from sabench.evaluation.record_schema import Record
from sabench.tasks.quality_figures import FIGURES_OF
from sabench.tasks.task import COSTS, Score, Task


class Table(NamedTuple):
    """Table of a task: of scores, or of figures without truth."""

    task: Task
    recorded: bool

    @property
    def name(self) -> str:
        """Name on the page, unique."""
        return f"{self.task.name}, recorded" if self.recorded else self.task.name

    @property
    def columns(self) -> tuple[Score, ...]:
        """Scores that it shows, the one that ranks first, if there is one."""
        if not self.recorded:
            return self.task.columns
        return (
            *FIGURES_OF.get(self.task.name, ()),
            *(score for score in COSTS if not score.hidden),
        )


def every_table() -> list[Table]:
    """List the tables of all tasks in the order of the leaderboard."""
    return [Table(task, recorded) for task in tasks.every() for recorded in (False, True)]


def table_of(record: Record) -> Table:
    """Return the table in which a record stands."""
    return Table(tasks.of(record["task"]), bool(record.get("recorded")))


def with_figures(record: Record) -> Record:
    """Give the figures without truth of a recorded data set names like scores."""
    judged = record.get("quality")
    return {**record, **judged["figures"]} if record.get("recorded") and judged else record
