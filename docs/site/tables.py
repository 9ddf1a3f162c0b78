"""Tables of the pages, made from records, the schema of scenes and the sizes of files.

A page names a table by a comment, `<!-- table: NAME ARGUMENTS -->`; the site shows
the table in its place. A table of files after `<!-- lines of each file -->` gets their sizes.
`python docs/site/tables.py PAGE` prints a page with its tables.
"""

from __future__ import annotations

import csv
import functools
import json
import re
import shlex
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT)]

import particle_tables  # noqa: E402
import scene_reference  # noqa: E402
from markdown_table import written  # noqa: E402

if TYPE_CHECKING:
    from sphinx.application import Sphinx

RECORDS = ROOT / "benchmarks" / "records"
MARKER = re.compile(r"^<!-- table: (.+) -->$", re.MULTILINE)
_FILES = re.compile(r"^<!-- lines of each file -->\n((?:\|.*\n)+)", re.MULTILINE)


def filled(text: str) -> str:
    """Return the text of a page with its tables, and with the sizes of the files that it lists."""
    text = _FILES.sub(lambda found: "\n".join([*map(_with_lines, found[1].splitlines()), ""]), text)
    return MARKER.sub(lambda found: table(*shlex.split(found[1])), text)


def _with_lines(row: str) -> str:
    """Add a column to a row of a table: the number of lines of the file in its first cell."""
    name = row.split("|")[1].strip()
    if name == "file":
        return f"{row} lines |"
    if not name.startswith("`"):
        return f"{row}---|"
    return f"{row} {len((ROOT / name.strip('`')).read_text(encoding='utf-8').splitlines())} |"


@functools.cache
def table(name: str, *arguments: str) -> str:
    """Make one table."""
    return _TABLES[name](*arguments)


def add_tables(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the tables into a page of the site."""
    source[0] = filled(source[0])


def suite(name: str) -> str:
    """Write the table of scores that `benchmarks/records/suites/NAME.csv` holds."""
    head, *rows = _suite(name)
    return written(head, rows)


def pivot(name: str, score: str) -> str:
    """Write one score of a suite: a column for each solver, the best of a row in bold."""
    head, *rows = _suite(name)
    at = head.index("solver")
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        found.setdefault(tuple(row[:at]), {})[row[at]] = row[head.index(score)]
    solvers = _best_first(found.values())
    lines = [
        [*case, *(_bold(cells[solver], max(cells.values(), key=float)) for solver in solvers)]
        for case, cells in found.items()
    ]
    return written([*head[:at], *solvers], lines)


def _best_first(rows: Collection[dict[str, str]]) -> list[str]:
    names = next(iter(rows))
    return sorted(names, key=lambda solver: -sum(float(cells[solver]) for cells in rows))


def _suite(name: str) -> list[list[str]]:
    with (RECORDS / "suites" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def _bold(cell: str, best: str) -> str:
    return f"**{cell}**" if cell == best else cell


def standard(kind: str) -> str:
    """Write the main score of one task of suite `standard`, from the bundled records."""
    from benchmarks.standard_tables import table as make

    return make(_standard()[kind])


@functools.cache
def _standard() -> dict[str, dict[str, dict[str, str]]]:
    from benchmarks.standard_tables import tables_of

    lines = (ROOT / "leaderboard" / "records" / "standard.jsonl").read_text(encoding="utf-8")
    return tables_of([json.loads(line) for line in lines.splitlines()])


def realism(family: str, score: str) -> str:
    """Write the cost of each effect of suite `realism` to each solver."""
    from benchmarks.realism import effects_of, table as make

    record = _read("realism")[f"{family}, {score}"]
    scores = {
        tuple(key.split(", ")): {int(seed): value for seed, value in own.items()}
        for key, own in record.items()
    }
    return make(scores, effects_of(family))


def calibration_reality(part: str) -> str:
    """Write the `starts` or the `errors` of calibrations of real tanks."""
    from benchmarks.calibration_reality import tables

    starts, errors = "\n".join(tables(_read("calibration-reality"))).split("\n\n")
    return {"starts": starts, "errors": errors}[part]


def ghost_bias(part: str) -> str:
    """Write `volumes` or `responses` of the benchmark of correlated ghosts."""
    from benchmarks import ghost_bias as benchmark

    return {"volumes": benchmark.volumes, "responses": benchmark.responses}[part](
        _read("ghost-bias")
    )


def rules(room: str) -> str:
    """Write what each rule of a room is worth."""
    from benchmarks.ablation import table_of

    return table_of(_read("ablation"), room)


def _read(name: str) -> Any:
    return json.loads((RECORDS / f"{name}.json").read_text(encoding="utf-8"))


_TABLES: dict[str, Callable[..., str]] = {
    "scene": scene_reference.reference,
    "scenes": scene_reference.pictures,
    "density": particle_tables.density,
    "rules": rules,
    "tracking": particle_tables.tracking,
    "suite": suite,
    "pivot": pivot,
    "standard": standard,
    "realism": realism,
    "calibration-reality": calibration_reality,
    "ghost-bias": ghost_bias,
}

if __name__ == "__main__":
    for page in sys.argv[1:]:
        print(filled(Path(page).read_text(encoding="utf-8")))
