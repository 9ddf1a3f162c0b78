"""The changelog is short: one page on the first version, then one line for each change."""

from __future__ import annotations

import re

import pytest

from tests.docs.pages import read

FIRST, LONGEST = 600, 20  # words of the first version, and of each later entry
_ENTRY = re.compile(r"- \S.*[^.]")


def faults(text: str) -> list[str]:
    """Say what is wrong with the form of a changelog."""
    *later, first = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    lines = [line for section in later for line in section.splitlines()[1:] if line]
    found = [
        f"expected an entry of at most {LONGEST} words on one line, got {line[:60]!r}"
        for line in lines
        if not _ENTRY.fullmatch(line) or len(line.split()) - 1 > LONGEST
    ]
    count = len(first.split())
    return found + [f"first version: expected {FIRST} words, got {count}"] * (count > FIRST)


def test_the_changelog_has_this_form() -> None:
    assert not faults(read("CHANGELOG.md"))


@pytest.mark.parametrize(
    ("entry", "count"),
    [
        ("- Solver `msa` reads half-covered images (scores change)", 0),
        ("- " + "word " * 20 + "more", 1),
        ("A paragraph", 1),
        ("- One line\n  and another", 1),
        ("- A sentence.", 1),
    ],
)
def test_other_forms_are_found(entry: str, count: int) -> None:
    text = f"# Changelog\n\n## Unreleased\n\n{entry}\n\n## 0.1.0\n\nIt exists.\n"
    assert len(faults(text)) == count
