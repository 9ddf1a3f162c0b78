"""Content of the leaderboard page: tasks, cases and rows as values of JSON.

Results of recorded data sets have separate tables, without scores and without ranks.
"""

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from typing import Any, NamedTuple

from sabench import plugins, tasks
from sabench.evaluation.leaderboard.cells import SAME_DIGITS, newest
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.tasks.quality import FIGURES_OF
from sabench.tasks.task import COSTS, Score, Task
from sabench.utils.confidence import Mean, mean_of, quantile


class ScoreTable(NamedTuple):
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
        return (*FIGURES_OF.get(self.task.name, ()), *(cost for cost in COSTS if not cost.hidden))


def every_table() -> list[ScoreTable]:
    """List the tables of all tasks in the order of the leaderboard."""
    return [ScoreTable(task, recorded) for task in tasks.every() for recorded in (False, True)]


def table_of(record: Record) -> ScoreTable:
    """Return the table of a record."""
    return ScoreTable(tasks.of(record["task"]), bool(record.get("recorded")))


def with_figures(record: Record) -> Record:
    """Give the figures without truth of a recorded data set names like scores."""
    judged = record.get("quality")
    return {**record, **judged["figures"]} if record.get("recorded") and judged else record


_NO_RANK = "Recorded images have no truth: their results have no rank."
_RESIDUALS = "The first frame's images of all cameras, then what the particles leave of each."
_MAIN = 3  # scores that are shown before all are asked for, and the two of cost
_CASE = ("task", "recorded", "case", "scene_hash", "renderer", "split")
ENTRY = (*_CASE, "solver", "parameters", "machine", "submission")  # of a row of the page
# largest degrees of freedom in the page's table of Student's quantiles; beyond them the last one is
# a little too wide
_DEGREES = 100


def cases_of(rows: Sequence[Record]) -> list[list[Record]]:
    """Sort rows of `over_seeds`, and group them by their cases."""
    shown = sorted(rows, key=_order)
    return [list(group) for _, group in groupby(shown, lambda row: key_of(row, _CASE))]


def describe_cases(cases: Sequence[Sequence[Record]]) -> dict[str, Any]:
    """Describe cases and their rows for the page."""
    pool, shown = _Pool(), {table_of(row).name for case in cases for row in case}
    solvers, bundled = plugins.readable("solvers")[0], plugins.bundled_folder("solvers")
    # quantiles are Student's for 1, 2, ... degrees of freedom, as in `sabench.utils.confidence`
    return {
        "tasks": {table.name: _table(table) for table in every_table() if table.name in shown},
        "cases": [_case(case) for case in cases],
        "rows": [_row(row, number, pool) for number, case in enumerate(cases) for row in case],
        "texts": pool.texts,
        "solvers": [[one.group, one.name] for one in solvers if one.file.parent == bundled],
        "quantiles": [short(quantile(degree + 1)) for degree in range(1, _DEGREES + 1)],
    }


class _Pool:
    """Texts that many rows share, referred to by their index."""

    def __init__(self) -> None:
        self._places: dict[str, int] = {}

    def __call__(self, text: object) -> int:
        return self._places.setdefault(str(text), len(self._places))

    @property
    def texts(self) -> list[str]:
        return list(self._places)


def _order(row: Record) -> tuple[Any, ...]:
    """Compute the sorting key of a row: task, case, rank within the case.

    Tasks are in their fixed order, recordings last, cases by name with numbers as numbers.
    """
    rest = (row["case"], row["scene_hash"], row["renderer"], row["split"])
    name = row["case"]
    parts = re.split(r"(\d+(?:\.\d+)?)", name)
    return (
        tasks.NAMES.index(row["task"]),
        bool(row.get("recorded")),
        [(float(part), "") if number % 2 else (-1.0, part) for number, part in enumerate(parts)],
        rest,
        rank_of(row),
        key_of(row, ENTRY),
    )


def rank_of(row: Record) -> tuple[bool, bool, float]:
    """Compute the rank key: best first score, then rows without a rank, then errors."""
    if not row["ranked"]:
        return bool(row["error"]), True, 0.0
    task = tasks.of(row["task"])
    first: Mean | None = row[task.columns[0].key]
    return (bool(row["error"]), *task.rank({task.columns[0].key: first.mean if first else None}))


def _table(table: ScoreTable) -> dict[str, Any]:
    """Describe a table for the page: its columns and the captions of its figures."""
    columns = [
        {
            "key": column.key,
            "heading": column.heading,
            "decimals": column.decimals,
            "meaning": column.meaning + (f"; {column.better} is better" if table.recorded else ""),
        }
        for column in table.columns
    ]
    # curve over the matching distance, if the task has one
    curve = None if table.recorded else table.task.tolerance
    residuals = {"errors": _RESIDUALS} if table.recorded else {}
    return {
        "columns": columns,
        "main": len(columns) if table.recorded else _MAIN,
        "larger": None if table.recorded else table.columns[0].better == "larger",
        "gate": _NO_RANK if table.recorded else gate_text(table.task),
        "tolerance": curve
        and {key: getattr(curve, key) for key in ("heading", "unit", "distances")},
        "pictured": asdict(table.task.captions) | residuals,
    }


def gate_text(task: Task) -> str:
    """Describe in one sentence which rows are ranked; "" where all are."""
    if task.gate is None:
        return ""
    gate, first = task.score_of(task.gate.key), task.columns[0]
    return f"{first.heading} ranks results whose {gate.heading} is {task.gate.least:g} or more."


def details_of(rows: Sequence[Record]) -> Record:
    """Collect the properties of a case from its records; older ones lack some values."""
    return {
        name: next((row[name] for row in rows if row.get(name)), None)
        for name in ("suite", "difficulty", "axis", "axes")
    }


def _case(rows: Sequence[Record]) -> dict[str, Any]:
    first = rows[0]
    hidden = "-hidden" if first["split"] == "hidden" else ""
    details = details_of(rows)
    head = {name: first[name] for name in ("scene", "renderer", "split")}
    tag = f"{first['case']}-{first['scene_hash'][:8]}-{first['renderer']}{hidden}"
    return {
        **head,
        "task": table_of(first).name,
        "recorded": bool(first.get("recorded")),
        **details,
        "axes": text_of(details["axes"] or {}),
        "id": tag,
        "name": first["case"],
        "hash": first["scene_hash"],
    }


def _row(row: Record, case: int, pool: _Pool) -> dict[str, Any]:
    """Make one line of the table; shared texts are indices into the pool."""
    runs: list[Record] = row["runs"]
    keys = [score.key for score in table_of(row).columns]
    machine = [row["machine"].get(key) for key in ("cpu", "backend")]
    reference = [run["reference_s"] for run in runs if run.get("reference_s")]
    optional = {"card": row.get("card"), "twin": row.get("same_estimates_as")}
    # return seconds and first score after iterations of the first run that has them
    steps = next((run["iterations"] for run in runs if run.get("iterations")), None)
    return {
        "id": hashlib.sha256(key_of(row, ENTRY).encode()).hexdigest()[:10],
        "case": case,
        "solver": pool(row.get("label") or row["solver"]),
        "name": pool(row["solver"]),
        "parameters": pool(text_of(row["parameters"])),
        "machine": pool(", ".join(str(part) for part in machine if part)),
        "machineAll": pool(text_of(row["machine"])),
        "versions": pool(text_of(row["versions"])),
        "submission": row.get("submission"),
        **{key: value for key, value in optional.items() if value},
        **({"iterations": [[short(value) for value in step] for step in steps]} if steps else {}),
        "commands": [pool(text) for text in commands(runs)],
        "seeds": [run["seed"] for run in runs],
        "datasets": [pool(run.get("identity") or run["dataset"]) for run in runs],
        "runs": [run["run_hash"] for run in runs],
        "codes": [
            pool(text)
            for text in dict.fromkeys(run["code_hash"] for run in runs if run.get("code_hash"))
        ],
        "date": newest(row)[:10],
        "reference": short(sum(reference) / len(reference)) if reference else None,
        "scores": [pair(row[key]) for key in keys],
        "values": [[None if run[key] is None else short(run[key]) for run in runs] for key in keys]
        if len(runs) > 1
        else None,
        "curve": _curve(row),
        "ranked": row["ranked"],
        "wholeProcess": any(run.get("whole_process") for run in runs),
        "open": any(run.get("isolated") is False for run in runs),
        "error": row["error"],
        "declined": bool(row["error"])
        and all(run.get("declined") for run in runs if run.get("error")),
    }


def _curve(row: Record) -> list[list[float] | None] | None:
    """Average the curve over the matching distance over the seeds; None without one."""
    keys = [] if row["recorded"] else [score.key for score in tasks.of(row["task"]).curve]
    values = [
        [run[key] for run in row["runs"] if run.get(key) is not None and not run.get("error")]
        for key in keys
    ]
    return [pair(mean_of(scores)) for scores in values] if any(values) else None


def commands(runs: Sequence[Record]) -> list[str]:
    """List the commands that reproduce a row.

    It is one command with all seeds if the commands differ in the seed alone, else one for each
    seed.
    """
    given = [run for run in runs if run.get("command")]
    plain = {
        re.sub(rf"--seed {run['seed']}(?= |$)", "--seed", run["command"], count=1) for run in given
    }
    if len(plain) == 1:
        return [
            re.sub(
                r"--seed(?= |$)",
                " ".join(f"--seed {run['seed']}" for run in given),
                plain.pop(),
                count=1,
            )
        ]
    return list(dict.fromkeys(run["command"] for run in given))


def pair(score: Mean | None) -> list[float] | None:
    """Return a mean with its half width, if there is one."""
    if score is None:
        return None
    figures = (score.mean, score.half_width)
    return [short(value) for value in figures if value is not None]


def short(value: float) -> float:
    """Round a number to the digits that the page may show."""
    return float(f"{value:.{SAME_DIGITS}g}")


def text_of(values: Record) -> str:
    """Format values as `key value, key value`, strings without quotes."""
    return ", ".join(
        f"{key} {value if isinstance(value, str) else json.dumps(value)}"
        for key, value in values.items()
    )
