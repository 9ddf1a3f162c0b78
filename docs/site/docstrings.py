"""Docstrings of the house's style for Sphinx: `name : meaning` in place of `name : type`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_SECTIONS = ("Parameters", "Attributes")
_ITEM = re.compile(r"(\*{0,2}\w+(?:, \*{0,2}\w+)*) : (.*)")


def describe_names(
    app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]
) -> None:
    """Move the meaning of each parameter to a line of its own, where numpydoc expects it."""
    lines[:] = rewritten(lines)


def skip_aliases(
    app: Sphinx, what: str, name: str, obj: object, skip: bool, options: Any
) -> bool | None:
    """Leave out attributes of classes that are classes: they have entries of their own."""
    return True if what == "class" and isinstance(obj, type) else None


def rewritten(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with meanings below the names."""
    found, section = [], ""
    for number, line in enumerate(lines):
        below = lines[number + 1] if number + 1 < len(lines) else ""
        if line and below and set(below.strip()) == {"-"}:
            section = line.strip()
        item = _ITEM.fullmatch(line) if section in _SECTIONS else None
        found += _entries(item[1].split(", "), item[2]) if item else [line]
    return found


def _entries(names: list[str], meaning: str) -> list[str]:
    """Return one entry for each of several names; the last one has the meaning."""
    *others, last = names
    return [line for name in others for line in (name, f"    See `{last}`.")] + [
        last, f"    {meaning}"
    ]  # fmt: skip
