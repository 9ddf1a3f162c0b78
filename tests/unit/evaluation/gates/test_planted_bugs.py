"""Bugs that the benchmark of the gate plants.

Each still fits the source that it changes.
"""

from __future__ import annotations

import pytest

from benchmarks.gate import ROOT
from benchmarks.planted_bugs import BUGS, Bug


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.title)
def test_the_line_to_replace_is_in_the_file_once(bug: Bug) -> None:
    text = (ROOT / bug.file).read_text(encoding="utf-8")
    assert text.count(bug.old) == 1
    assert bug.old != bug.new
