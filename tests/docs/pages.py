"""Pages of the documentation: their headings, links and code blocks."""

import functools
import itertools
import re
import runpy
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
_DOCS = (path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md")))
PAGES = ("README.md", "CONTRIBUTING.md", *_DOCS)

_FENCE = re.compile(r"( *)(`{3,})(\w*)\s*$")
_LINK = re.compile(r"\[[^\]]*\]\(([^()\s]+)\)")
_MARKER = re.compile(r"<!-- (not run|file): (.+?) -->$")


class Block(NamedTuple):
    """A fenced code block; a comment before it may say why it is not run, or name its file."""

    page: str
    line: int
    language: str
    text: str
    reason: str | None
    file: str | None

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def marked(self) -> bool:
        return self.reason is not None or self.file is not None

    @property
    def kind(self) -> str:
        if self.reason is not None:
            return "not run"
        if self.file is not None:
            return "saved"
        return "text" if self.language == "text" else "run"


def read(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


@functools.cache
def built(page: str) -> str:
    filled: Callable[[str], str] = site("tables")["filled"]
    return filled(read(page))


@functools.cache
def site(name: str) -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "site" / f"{name}.py"))


def blocks(page: str) -> list[Block]:
    return [part for part in _parts(page, read(page)) if isinstance(part, Block)]


def prose(page: str) -> list[tuple[int, str]]:
    return _lines(page, read(page))


def _lines(page: str, text: str) -> list[tuple[int, str]]:
    return [part for part in _parts(page, text) if not isinstance(part, Block)]


def _parts(page: str, text: str) -> Iterator[Block | tuple[int, str]]:
    lines = iter(enumerate(text.splitlines(), start=1))
    marker: dict[str, str] = {}
    for number, line in lines:
        fence = _FENCE.match(line)
        if fence is None:
            yield number, line
            marker = _marker(line) if line.strip() else marker
            continue
        indent, ticks, language = fence.groups()
        text = _until(ticks, lines, indent)
        yield Block(page, number, language, text, marker.get("not run"), marker.get("file"))
        marker = {}


def _until(ticks: str, lines: Iterator[tuple[int, str]], indent: str) -> str:
    inside = (line for _, line in lines)
    block = itertools.takewhile(lambda line: line.strip() != ticks, inside)
    return "".join(line.removeprefix(indent) + "\n" for line in block)


def _marker(line: str) -> dict[str, str]:
    found = _MARKER.match(line.strip())
    return {found[1]: found[2]} if found else {}


def links(page: str) -> list[tuple[int, str]]:
    lines = _lines(page, built(page))
    return [(number, target) for number, line in lines for target in _LINK.findall(line)]


def anchors(page: str) -> set[str]:
    found: Counter[str] = Counter()
    names = set()
    for _, line in _lines(page, built(page)):
        if heading := re.match(r"#+ (.*)", line):
            name = _anchor(heading[1])
            names.add(f"{name}-{found[name]}" if found[name] else name)
            found[name] += 1
    return names


def _anchor(heading: str) -> str:
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")
