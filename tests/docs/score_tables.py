"""Tables of scores in pages of tasks. Run `python -m tests.docs.score_tables [--write]`."""

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
    families: dict[tuple[str, str], list[Score]] = {}
    for score in scores:
        families.setdefault(_family(score, families), []).append(score)
    rows = [
        f"| {', '.join(f'`{one.key}`' for one in family)} | {family[0].unit or '-'} | "
        f"{_BETTER[family[0].better]} | {_cell(meaning if family[1:] else family[0].meaning)} |"
        for (_, meaning), family in families.items()
    ]
    return "\n".join(["| key | unit | better | meaning |", "|---|---|---|---|", *rows, ""])


def _family(score: Score, families: Iterable[tuple[str, str]]) -> tuple[str, str]:
    pattern = re.sub(r"(?<![a-z])[u-z](?=_)", "?", score.key)
    meaning = re.sub(r"along [XYZ]\b", "along each axis", score.meaning)
    if meaning == "the same along each axis":
        return pattern, next(name for same, name in families if same == pattern)
    return pattern, meaning


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def filled(text: str) -> str:
    return _TABLE.sub(lambda found: found[1] + table(_scores(found[2])) + found[3], text)


def _scores(name: str) -> tuple[Score, ...]:
    return tasks.of(name).scores


def outdated() -> list[Path]:
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    return [page for page, text in texts.items() if filled(text) != text]


def main() -> None:
    for page in outdated():
        print(page.relative_to(ROOT))
        if "--write" in sys.argv[1:]:
            page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
