"""Rows of the leaderboard, from records, and its static HTML page."""

from __future__ import annotations

from pathlib import Path

from sabench import tasks
from sabench.evaluation.leaderboard import page
from sabench.evaluation.leaderboard.score_columns import table_of, with_figures
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import key_of
from sabench.utils.confidence import mean_of
from sabench.utils.files import complete_or_nothing

_ENTRY = (
    "task",
    "recorded",
    "case",
    "scene_hash",
    "renderer",
    "split",
    "solver",
    "parameters",
    "machine",
    "submission",
)
_LARGEST = 1e15  # no meaningful score is beyond it, and its digits would fill the page


def over_seeds(records: list[Record]) -> list[Record]:
    """Merge the records of all seeds into one row.

    There is a row for every case, solver and machine. It is the first seed's record with `seeds`,
    `runs` and, in place of every score, its `Mean` over the seeds.

    A score that no seed has is None. `ranked` says whether the first score ranks every seed that
    has not failed, so that a seed that was left out improves no rank. `error` counts the seeds that
    failed and gives the first one's reason. `runs` are the records of the seeds. Records of
    unknown tasks make no rows. Those of recorded data sets have figures without truth in place of
    scores, and no rank.
    """
    groups: dict[str, list[Record]] = {}
    for record in sorted(records, key=lambda record: int(record["seed"])):
        task = record.get("task") or "reconstruction"
        if task in tasks.NAMES:
            named = {
                **record,
                "case": record.get("case") or record["scene"],
                "task": task,
                "split": record.get("split") or "public",
                "recorded": bool(record.get("recorded")),
            }
            groups.setdefault(key_of(named, _ENTRY), []).append(named)
    return [_merge(group) for group in groups.values()]


def _merge(group: list[Record]) -> Record:
    table = table_of(group[0])
    keys = [score.key for score in table.columns]
    runs = [
        {**record, **{key: _number(with_figures(record).get(key)) for key in keys}}
        for record in group
    ]
    means = {key: mean_of([run[key] for run in runs if run[key] is not None]) for key in keys}
    errors = [record["error"] for record in group if record.get("error")]
    share = f"{len(errors)} of {len(group)} seeds: " if len(group) > 1 and errors else ""
    error = share + errors[0] if errors else None
    return {
        **group[0],
        **means,
        "seeds": [run["seed"] for run in runs],
        "runs": runs,
        "error": error,
        "ranked": not table.recorded
        and not any(table.task.rank(run)[0] for run in runs if not run.get("error")),
    }


def _number(value: object) -> float | None:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return None
    return float(value) if -_LARGEST < value < _LARGEST else None


def build_page(records: list[Record], pictures: Path, out: Path) -> None:
    """Write the records as one self-contained page.

    `pictures` holds the folders that the records name; figures outside it are left out.
    """
    text = page.render(over_seeds(records), pictures)
    with complete_or_nothing(out, overwrite=True) as partial:
        partial.write_text(text, encoding="utf-8")
