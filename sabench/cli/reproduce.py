"""Command on Belden's thesis: reproduce."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, say_json
from sabench.utils.number_text import significant

if TYPE_CHECKING:
    from sabench.plotting.charts import Figure


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME...",
            help="What to measure: table-2-1, fig-2-6, ... or all; an unknown name lists them.",
        ),
    ] = None,
    as_list: Annotated[
        bool,
        typer.Option(
            "--list", help="List all tables and figures of the thesis with recorded verdicts."
        ),
    ] = False,
    as_json: AsJson = False,
    seeds: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of seeds to average over.")
    ] = None,
    pixels: Annotated[
        int | None,
        typer.Option(
            min=32,
            metavar="N",
            help="Use small images of this size for a quick trial; the results are not comparable.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Write each name's rows to a JSON file when it is done; other rows stay.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write plots of the curves, and a page of all values."),
    ] = None,
) -> None:
    """Reproduce tables and figures of Belden's thesis and compare the values."""
    from sabench.utils.errors import InputError

    if as_list and names:
        raise InputError(f"reproduce: expected no names beside --list, got {names[0]}")
    if as_list:
        _list(as_json)
    elif names:
        rows = _measure(names, seeds, pixels, output, figures)
        say_json(rows) if as_json else _show_rows(rows)
    else:
        raise InputError("reproduce: expected names of tables and figures, all, or --list")


def _list(as_json: bool) -> None:
    from sabench.evaluation.thesis.catalogue import MEASURED, judged, read_rows

    entries = judged(read_rows(MEASURED))
    if as_json:
        say_json(entries)
        return
    cells = [[one["name"], one["shows"], one["verdict"], one["item"]] for one in entries]
    tables.show_wrapped(["name", "shows", "verdict", "measured by"], cells)


def _measure(
    names: Sequence[str],
    seeds: int | None,
    pixels: int | None,
    output: Path | None,
    folder: Path | None,
) -> list[dict[str, Any]]:
    """Measure item by item; rows of one replace those of the file once it is whole."""
    from dataclasses import asdict

    from sabench.evaluation.thesis import reproduce, resolve
    from sabench.evaluation.thesis.catalogue import read_rows
    from sabench.plotting.charts import Figure
    from sabench.utils.progress import announce_compiling

    chosen = resolve(names)
    kept = read_rows(output) if output else []
    announce_compiling()
    rows: list[dict[str, Any]] = []
    plots: dict[str, list[Figure]] = {}
    for name in chosen:
        for item in reproduce([name], seeds, pixels):
            if isinstance(item, Figure):
                plots.setdefault(name, []).append(item)
                _write_plot(item, folder)
                continue
            rows.append(asdict(item))
            _report_row(rows[-1])
        kept = [row for row in kept if row["item"] != name]
        _write_rows([*kept, *rows], output)
        _write_page(rows, plots, folder)
    return rows


def _write_plot(plot: Figure, folder: Path | None) -> None:
    if folder is None:
        return
    from sabench.plotting.drawing import draw
    from sabench.utils.files import complete_or_nothing

    folder.mkdir(parents=True, exist_ok=True)
    with complete_or_nothing(folder / f"{plot.name}.png", overwrite=True) as partial:
        partial.write_bytes(draw(plot))


def _write_rows(rows: list[dict[str, Any]], file: Path | None) -> None:
    """Write all rows so far, so that an interrupted run keeps them."""
    if file is None:
        return
    from sabench.utils.files import canonical_json, complete_or_nothing

    with complete_or_nothing(file, overwrite=True) as partial:
        partial.write_text(canonical_json(rows), encoding="utf-8")


def _write_page(
    rows: list[dict[str, Any]], plots: dict[str, list[Figure]], folder: Path | None
) -> None:
    if folder is None:
        return
    from sabench.evaluation.thesis import TABLES
    from sabench.evaluation.thesis.catalogue import MEASURED, judged, read_rows
    from sabench.evaluation.thesis.report import render
    from sabench.utils.files import complete_or_nothing

    folder.mkdir(parents=True, exist_ok=True)
    now = {row["item"] for row in rows}
    recorded = [row for row in read_rows(MEASURED) if row["item"] not in now]
    page = render(judged([*recorded, *rows]), rows, TABLES, plots)
    with complete_or_nothing(folder / "index.html", overwrite=True) as partial:
        partial.write_text(page, encoding="utf-8")


def _report_row(row: dict[str, Any]) -> None:
    from sabench.utils.progress import console

    values = f"{significant(row['measured'])}, thesis {significant(row['thesis'])}"
    console.print(f"{row['name']}: {values}: {row['verdict']}", markup=False, highlight=False)


def _show_rows(rows: list[dict[str, Any]]) -> None:
    """Print the values of the thesis next to the measured ones."""
    cells = []
    for row in rows:
        spread = "" if row["ci95"] is None else f" ± {row['ci95']:.2g}"
        values = [significant(row["thesis"]), significant(row["measured"]) + spread]
        cells.append([row["name"], *values, str(row["seeds"] or "-"), row["verdict"], row["note"]])
    tables.show_wrapped(["row", "thesis", "measured", "seeds", "verdict", "note"], cells)
