"""The tables of scores in the documents are those of the tasks."""

from __future__ import annotations

import re

from sabench import tasks
from tests.docs.pages import ROOT
from tests.docs.score_tables import PAGES, outdated


def test_tables_of_scores_are_those_of_the_tasks() -> None:
    names = [page.relative_to(ROOT).as_posix() for page in outdated()]
    assert not names, f"run python -m tests.docs.score_tables --write: {', '.join(names)}"


def test_every_task_has_a_table_of_scores() -> None:
    marked = re.findall(
        r"<!-- scores: (\w+) -->", "".join(page.read_text(encoding="utf-8") for page in PAGES)
    )
    assert sorted(marked) == sorted(tasks.NAMES)
