"""Records to page: reads the JSON lines that runs left and renders one static HTML file."""

from __future__ import annotations

import base64
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from sabench import plugins
from sabench.columns import COLUMNS, LARGER_IS_BETTER, Column
from sabench.files import complete_or_nothing, inside
from sabench.records import Record, key_of
from sabench.statistics import Mean, mean_of

_ENTRY = ("track", "case", "scene_hash", "renderer", "solver", "parameters", "machine")
_SECTION = ("track", "case", "scene_hash", "renderer")
_PICTURED = {  # heading and text of a section's pictures
    "reconstruction": (
        "Middle slice",
        "The same central window of the middle z plane of the scored volume, x to the right, y down; each picture has its own brightness scale.",
    ),
    "particles": (
        "Particles in the middle slice",
        "Found particles as balls of light on the grid, in the same window of the middle z plane of the scored volume, x to the right, y down.",
    ),
    "calibration": (
        "Errors in the images",
        "From where the target's points were found to where the calibration sees them; the number says how much longer.",
    ),
    "velocimetry": (
        "Fields",
        "The first pair: vectors and vorticity of a middle plane, errors there, all errors against each other, a profile beside the exact one.",
    ),
    "bubbles": (
        "Bubbles from the front and from the side",
        "Every bubble as a circle of its radius, which its colour gives, too; X to the right or Z, Y down.",
    ),
    "see_through": (
        "The code's plane",
        "The plane of the stack in which the code behind the bubbles is, each with its own brightness scale.",
    ),
}

_LARGEST = 1e15  # beyond it no score is meant, and digits would fill the page


def over_seeds(records: list[Record]) -> list[Record]:
    """One row for every case, solver and machine: the first seed's record with `seeds` and, in place of every score, its `Mean` over them.

    A score that no seed has is None. `error` counts the seeds that failed and says why the first one did.
    """
    groups: dict[str, list[Record]] = {}
    for record in sorted(records, key=lambda record: int(record["seed"])):
        named = {**record, "case": record.get("case") or record["scene"], "track": record.get("track") or "reconstruction"}
        groups.setdefault(key_of(named, _ENTRY), []).append(named)
    return [_merged(group) for group in groups.values()]


def _merged(group: list[Record]) -> Record:
    keys = [column.key for column in COLUMNS[group[0]["track"]]]
    means = {key: mean_of([value for record in group if (value := _number(record.get(key))) is not None]) for key in keys}
    errors = [record["error"] for record in group if record.get("error")]
    share = f"{len(errors)} of {len(group)} seeds: " if len(group) > 1 and errors else ""
    return {**group[0], **means, "seeds": [record["seed"] for record in group], "error": share + errors[0] if errors else None}


def build_page(records: list[Record], pictures: Path, out: Path) -> None:
    """Write the records as one self-contained page; `pictures` holds the folders that the records name.

    Raises
    ------
    InputError
        A record whose pictures would lie outside `pictures`.
    """
    folder = plugins.bundled("leaderboard")
    # Autoescape is what keeps a foreign record's text from becoming markup.
    environment = Environment(loader=FileSystemLoader(folder), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    sections = _sections(records, pictures)
    shown = {section["track"] for section in sections}
    page = environment.get_template("page.html.j2").render(sections=sections, tracks={name: COLUMNS[name] for name in COLUMNS if name in shown})
    with complete_or_nothing(out, overwrite=True) as partial:
        partial.write_text(page, encoding="utf-8", errors="replace")  # JSON can hold half a surrogate pair, UTF-8 can not


def _sections(records: list[Record], pictures: Path) -> list[dict[str, Any]]:
    """One section per case, scene and renderer, in the order of their names."""
    ordered = sorted(over_seeds(records), key=lambda row: tuple(row[name] for name in _SECTION))
    groups = itertools.groupby(ordered, key=lambda row: key_of(row, _SECTION))
    return [_section(sorted(group, key=_rank), pictures) for _, group in groups]


def _section(ranked: list[Record], pictures: Path) -> dict[str, Any]:
    first, *others = COLUMNS[ranked[0]["track"]]
    columns = (first, *(column for column in others if any(row[column.key] is not None for row in ranked)))  # a scene need not have every figure
    rows = [_row(row, columns, pictures) for row in ranked]
    head = {name: ranked[0][name] for name in _SECTION}
    seeds = sorted({seed for row in ranked for seed in row["seeds"]})
    axes: Record = next((row["axes"] for row in ranked if row.get("axes")), {})
    words = {"seeds": _seeds(seeds), "axes": _text(axes), "columns": columns, "falling": LARGER_IS_BETTER[head["track"]]}
    shown, told = _PICTURED[head["track"]]
    truth = _first(ranked, pictures, "truth.png") if head["track"] != "velocimetry" else None  # particles, where the solvers' pictures show fields
    return {**head, **words, "rows": rows, "shown": shown, "told": told, "images": _first(ranked, pictures, "images.png"), "truth": truth}


def _seeds(seeds: list[int]) -> str:
    return f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {', '.join(map(str, seeds))}"


def _rank(row: Record) -> tuple[bool, bool, float, str, str]:
    """Best first column first, then those without, then errors; the rest settles ties so that equal records give equal pages."""
    first: Mean | None = row[COLUMNS[row["track"]][0].key]
    sign = -1.0 if LARGER_IS_BETTER[row["track"]] else 1.0
    return bool(row["error"]), first is None, sign * first.mean if first else 0.0, row["solver"], _text(row["parameters"])


def _row(row: Record, columns: Sequence[Column], pictures: Path) -> dict[str, Any]:
    machine = row["machine"]
    return {
        "solver": row.get("label") or row["solver"],
        "parameters": _text(row["parameters"]),
        "scores": [_cell(row[column.key], column.decimals) for column in columns],
        "error": row["error"],
        "machine": [str(machine[key]) for key in ("cpu", "backend") if machine.get(key)],
        "details": _text({"seeds": row["seeds"], "data set": row["dataset"], "run": row["run_hash"], **machine, **row["versions"]}),
        # A failed run may have left a picture when it once succeeded: it is not this record's.
        "picture": None if row["error"] else _picture(row, pictures, f"{row['solver']}-{row['run_hash'][:8]}.png"),
    }


def _text(values: Record) -> str:
    """`key value, key value`, strings without quotes."""
    return ", ".join(f"{key} {value if isinstance(value, str) else json.dumps(value)}" for key, value in values.items())


def _number(value: object) -> float | None:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return None
    return float(value) if -_LARGEST < value < _LARGEST else None


def _cell(score: Mean | None, decimals: int) -> tuple[str, str]:
    """The number to sort by and the text to show, both empty for None."""
    return ("", "") if score is None else (repr(score.mean), score.text(decimals))


def _first(ranked: list[Record], pictures: Path, name: str) -> str | None:
    return next((data for record in ranked if (data := _picture(record, pictures, name))), None)


def _picture(record: Record, pictures: Path, name: str) -> str | None:
    """A picture of a record as a data: URI, None if there is none."""
    if record.get("pictures") is None:
        return None
    path = inside(pictures, f"{record['pictures']}/{name}")
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}" if path.is_file() else None
