"""Texts of a challenge: pages for its participants."""

from __future__ import annotations

from pathlib import Path
from string import Template

from sabench import tasks
from sabench.evaluation.challenge.contents import Challenge
from sabench.evaluation.challenge.scoring import COSTS
from sabench.evaluation.leaderboard.page_content import gate_text
from sabench.evaluation.solver_card import SolverCard

_FOLDER = Path(__file__).with_name("pages")
NAMES = ("overview", "data", "evaluation", "terms")
CARD_TEMPLATE = "".join(
    f'# {field.description}\n{name} = ""\n' for name, field in SolverCard.model_fields.items()
)


def page(name: str, challenge: Challenge) -> str:
    """Fill in a page in Markdown: one of `NAMES`."""
    task = tasks.of(challenge.task)
    shown = [one for one in task.columns if one.key not in COSTS]
    scores = "\n".join(f"| {one.heading} | {one.meaning} |" for one in shown)
    values = {
        "title": challenge.title,
        "task": challenge.task,
        "count": len(challenge.data_sets),
        "first": task.columns[0].heading,
        "gate": gate_text(task),
        "scores": scores,
        "version": challenge.sabench,
    }
    text = (_FOLDER / f"{name}.md").read_text(encoding="utf-8")
    return Template(text).substitute(values)
