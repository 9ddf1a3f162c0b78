"""Page of the documentation on the reproduction: verdicts, findings and figures."""

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from . import MEASUREMENTS
from .catalogue import MEASURED, judged, read_rows

PAGE = "docs/results/reproduction"
_FINDINGS = Path(__file__).with_name("results.toml")
_OWN_IMAGES = Path(__file__).with_name("images")


def add_results(app: Any, name: str, source: list[str]) -> None:
    """Append verdicts and findings to the page when Sphinx reads it."""
    if name == PAGE:
        source[0] += render()


def render() -> str:
    """Write verdicts and findings as Markdown."""
    findings = tomllib.loads(_FINDINGS.read_text(encoding="utf-8"))["section"]
    return "\n".join([*_verdicts(), *(line for section in findings for line in _section(section))])


def _verdicts() -> Iterator[str]:
    yield "\n## Measurements\n"
    yield _table(
        ("command", "contents", "seeds"),
        [(f"`{name}`", entry.title, str(entry.seeds)) for name, entry in MEASUREMENTS.items()],
    )
    yield "\n## Recorded verdicts\n"
    entries = judged(read_rows(MEASURED))
    keys = ("name", "shows", "verdict", "item")
    yield _table(
        ("name", "contents", "verdict", "measured by"),
        [[entry[key] for key in keys] for entry in entries],
    )


def _section(section: Mapping[str, Any]) -> Iterator[str]:
    """Write a section: a chapter's, or that of a command with its values."""
    command = section.get("command")
    yield f"\n### {section['title']}: `{command}`\n" if command else f"\n## {section['title']}\n"
    for table in section.get("table", ()):
        yield table.get("caption", "")
        yield _table(table["columns"], table["rows"]) + "\n"
    yield section.get("text", "")
    for image, caption in section.get("images", ()):
        local = (_OWN_IMAGES / f"{image}.png").is_file()
        folder = "../../reproduction/images" if local else "../images"
        yield f"![{caption}]({folder}/{image}.png)"


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
