"""Results of recorded cases, judged without truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.dataset.results import open_result
from sabench.evaluation.suites import RecordedCase
from sabench.tasks.quality import quality, residual_picture
from sabench.tasks.quality_figures import FIGURES_OF
from sabench.tasks.solve_and_score import costs_of
from sabench.utils.progress import console


@dataclass(frozen=True)
class Judged:
    """Scores of a result, or its figures without truth.

    Attributes
    ----------
    scores : what its record says of it.
    residuals : a PNG of what particles leave of recorded images; None for other results.
    """

    scores: dict[str, Any]
    residuals: bytes | None = None


def judge(case: RecordedCase, out: Path) -> Judged:
    """Judge a result of a recorded case by its images; its costs come with it.

    Results of tasks that have no figures without truth have their costs alone.
    """
    result = open_result(out, case.data)
    scores = {"task": result.task, "quality": None, **costs_of(result)}
    if result.task not in FIGURES_OF:
        return Judged(scores)
    options = case.quality
    judged = quality(case.data, out, frames=options.frames, solve_again=options.again)
    for note in judged.notes:
        console.print(f"note: {note}", markup=False, highlight=False)
    scores["quality"] = {**options.model_dump(), "figures": judged.figures}
    left = judged.left
    return Judged(scores, None if left is None else residual_picture(case.data, left))
