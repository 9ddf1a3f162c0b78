"""Pages of the documentation: their headings, links and code blocks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGES = tuple(
    path.relative_to(ROOT).as_posix()
    for path in (
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").rglob("*.md")),
    )
)

_FENCE = re.compile(r"( *)(`{3,})(\w*)\s*$")
_LINK = re.compile(r"\[[^\]]*\]\(([^()\s]+)\)")
_REASON = re.compile(r"<!-- not run: (.+?) -->\s*$")


class Block(NamedTuple):
    """A fenced code block: its page, line, language, text, and why it is not run, if it is not."""

    page: str
    line: int
    language: str
    text: str
    reason: str | None

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def read(page: str) -> str:
    """Return the text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str) -> list[Block]:
    """Return the fenced code blocks of a page in their order."""
    return [part for part in _parts(page) if isinstance(part, Block)]


def prose(page: str) -> list[tuple[int, str]]:
    """Return the lines outside code blocks, each with its number."""
    return [part for part in _parts(page) if not isinstance(part, Block)]


def _parts(page: str) -> Iterator[Block | tuple[int, str]]:
    """Yield lines of prose and code blocks in their order."""
    lines = iter(enumerate(read(page).splitlines(), start=1))
    reason = None
    for number, line in lines:
        fence = _FENCE.match(line)
        if fence is None:
            yield number, line
            reason = _next_reason(line, reason)
            continue
        indent, ticks, language = fence.groups()
        text = []
        for _, inside in lines:
            if inside.strip() == ticks:
                break
            text.append(inside.removeprefix(indent) + "\n")
        yield Block(page, number, language, "".join(text), reason)
        reason = None


def _next_reason(line: str, reason: str | None) -> str | None:
    """Return the reason of a marker, which lasts over empty lines."""
    marker = _REASON.match(line.strip())
    if marker is not None:
        return marker[1]
    return None if line.strip() else reason


def links(page: str) -> list[tuple[int, str]]:
    """Return the targets of a page's links outside code blocks, each with its line."""
    return [(number, target) for number, line in prose(page) for target in _LINK.findall(line)]


def anchors(page: str) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    found: Counter[str] = Counter()
    names = set()
    for _, line in prose(page):
        heading = re.match(r"#+ (.*)", line)
        if heading is None:
            continue
        name = _anchor(heading[1])
        names.add(f"{name}-{found[name]}" if found[name] else name)
        found[name] += 1
    return names


def _anchor(heading: str) -> str:
    """Return the anchor of one heading: lower case, hyphens for blanks, no other punctuation."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
