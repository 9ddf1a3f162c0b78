"""Estimates that are wrong in a known way, and their scores.

A bug in a metric that flatters every solver shows in these.
"""

from __future__ import annotations

from pathlib import Path

from sabench import tasks
from sabench.dataset.reader import Dataset
from sabench.dataset.results import result_writer
from sabench.tasks.solve_and_score import score


def score_known_wrong(data: Dataset, out: Path) -> dict[str, float]:
    """Score the wrong estimates of all tasks that a data set serves.

    Temporary results are written to `out`.

    Returns
    -------
    Scores by names like `probe.reconstruction.q`.
    """
    figures: dict[str, float] = {}
    for task in tasks.every():
        if not task.accepts(data):
            continue
        with result_writer(out, data, "probe", task.name, {}, overwrite=True) as writer:
            for frame in task.frames(data):
                writer.add(task.wrong(data, frame), frame)
        scores = score(data, out)
        known = {one.key: scores.get(one.key) for one in task.all_scores}
        figures |= {
            f"probe.{task.name}.{key}": float(value)
            for key, value in known.items()
            if value is not None
        }
    return figures
