"""Tables of scores in the pages of the tasks.

Run `python -m tests.docs.score_tables [--write]`.

A page holds its table between `<!-- scores: TASK -->` and `<!-- end scores -->`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from pathlib import Path

from sabench import tasks
from sabench.tasks.task import Score
from tests.docs.pages import ROOT

_BETTER = {"larger": "larger", "smaller": "smaller", "unity": "nearer 1", "steady": "-"}
_TABLE = re.compile(r"(<!-- scores: (\w+) -->\n).*?(<!-- end scores -->)", re.DOTALL)
PAGES = tuple(sorted((ROOT / "docs" / "tasks").glob("*.md")))


def table(scores: Iterable[Score]) -> str:
    """Write scores as a table, one row for each."""
    rows = [
        (
            f"| `{score.key}` | {score.unit or '-'} | {_BETTER[score.better]} | "
            f"{_cell(score.meaning)} |"
        )
        for score in scores
    ]
    return "\n".join(["| key | unit | better | meaning |", "|---|---|---|---|", *rows, ""])


def _cell(text: str) -> str:
    """Escape what would end a cell."""
    return text.replace("|", "\\|")


def filled(text: str) -> str:
    """Return the text of a page with its tables made anew."""
    return _TABLE.sub(lambda found: found[1] + table(_scores(found[2])) + found[3], text)


def _scores(name: str) -> tuple[Score, ...]:
    """Return all scores of a task."""
    return tasks.of(name).all_scores


def outdated() -> list[Path]:
    """Return the pages whose tables are not those of the tasks."""
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    return [page for page, text in texts.items() if filled(text) != text]


def main() -> None:
    """List the pages with outdated tables, or write them anew."""
    for page in outdated():
        print(page.relative_to(ROOT))
        if "--write" in sys.argv[1:]:
            page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
