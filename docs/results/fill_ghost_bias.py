"""Fill the tables on correlated ghosts from the record of benchmarks/ghost_bias.py.

Run python docs/results/fill_ghost_bias.py after the benchmark has changed its record; tests/docs
compares pages and record.
"""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = tuple(ROOT / "docs" / "tasks" / f"{name}.md" for name in ("reconstruction", "velocimetry"))
_TABLE = re.compile(r"(<!-- ghost bias: (\w+) -->\n).*?(\n<!-- end ghost bias -->)", re.DOTALL)


def filled(text: str) -> str:
    """Return a page's text with its tables made anew."""
    benchmark = runpy.run_path(str(ROOT / "benchmarks" / "ghost_bias.py"))
    record = json.loads(benchmark["RECORD"].read_text(encoding="utf-8"))
    return _TABLE.sub(lambda found: found[1] + benchmark[found[2]](record) + found[3], text)


def main() -> None:
    """Write the pages anew."""
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
