"""Rows written to a file, and a page of them with curves next to the values."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

from sabench.plotting.drawing import Figure, draw
from sabench.plotting.page import render_page
from sabench.utils.files import canonical_json, complete_or_nothing
from sabench.utils.number_text import significant
from sabench.utils.progress import announce_compiling, console

from . import MEASUREMENTS, reproduce, resolve
from .catalogue import MEASURED, judged, read_rows

_TEMPLATE = Path(__file__).with_name("report.html.j2")


def measure(
    names: Sequence[str],
    seeds: int | None,
    pixels: int | None,
    output: Path | None,
    folder: Path | None,
) -> list[dict[str, Any]]:
    """Measure item by item, and write rows, plots and page.

    Rows of an item replace those of the file when all of them are measured.

    `output` is a JSON file of rows, `folder` that of plots and of a page of all values.
    """
    chosen = resolve(names)
    earlier = read_rows(output) if output else []
    announce_compiling()
    rows: list[dict[str, Any]] = []
    plots: dict[str, list[Figure]] = {}
    for name in chosen:
        for item in reproduce([name], seeds, pixels):
            if isinstance(item, Figure):
                plots.setdefault(name, []).append(item)
                if folder:
                    _write(folder / f"{item.name}.png", draw(item))
                continue
            rows.append(asdict(item))
            values = f"{significant(item.measured)}, thesis {significant(item.thesis)}"
            console.print(f"{item.name}: {values}: {item.verdict}", markup=False, highlight=False)
        earlier = [row for row in earlier if row["item"] != name]
        if output:  # an interrupted run keeps what is complete
            _write(output, canonical_json([*earlier, *rows]).encode())
        if folder:
            _write(folder / "index.html", _page(rows, plots).encode())
    return rows


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with complete_or_nothing(file, overwrite=True) as partial:
        partial.write_bytes(content)


def _page(rows: Sequence[Mapping[str, Any]], plots: Mapping[str, Sequence[Figure]]) -> str:
    """Render a page with its plots as files NAME.png next to it."""
    now = {row["item"] for row in rows}
    recorded = [row for row in read_rows(MEASURED) if row["item"] not in now]
    values = {
        "entries": judged([*recorded, *rows]),
        "items": {name: list(group) for name, group in groupby(rows, lambda row: row["item"])},
        "measurements": MEASUREMENTS,
        "plots": plots,
        "small": any(row["pixels"] for row in rows),
    }
    filters: dict[str, Callable[..., object]] = {
        "value": significant,
        "grade": _grade,
        "interval": _interval,
    }
    return render_page(_TEMPLATE.read_text(encoding="utf-8"), values, filters)


def _interval(half: float | None) -> str:
    return "" if half is None else f" ± {half:.2g}"


def _grade(verdict: str) -> str:
    return {
        "reproduced": "good",
        "exceeds": "good",
        "below": "bad",
        "not reproduced": "bad",
        "not reached": "bad",
    }.get(verdict, "")
