"""Fill the tables of suite `standard` in by-suite.md from the bundled records.

Run python docs/results/fill_standard.py after these have changed; tests/docs compares page and
records.
"""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "results" / "by-suite.md"
RECORDS = ROOT / "leaderboard" / "records" / "standard.jsonl"
_TABLE = re.compile(r"(<!-- standard: ([a-z-]+) -->\n).*?(\n<!-- end standard -->)", re.DOTALL)


def filled(text: str) -> str:
    """Return the page's text with its tables made anew."""
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "standard_tables.py"))
    lines = RECORDS.read_text(encoding="utf-8").splitlines()
    found = benchmark["tables_of"]([json.loads(line) for line in lines])
    return _TABLE.sub(lambda it: it[1] + benchmark["table"](found[it[2]]) + it[3], text)


def main() -> None:
    """Write the page anew."""
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
