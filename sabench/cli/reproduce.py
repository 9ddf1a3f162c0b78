"""Command on Belden's thesis: reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, say_json


def reproduce(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME...",
            help="Tables and figures: table-2-1, fig-2-6, ...; an unknown name lists all.",
        ),
    ],
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
            "-o", "--output", metavar="FILE", help="Write the rows to a JSON file, one by one."
        ),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write plots of the curves, too.")
    ] = None,
) -> None:
    """Reproduce tables and figures of Belden's thesis and compare the values."""
    from dataclasses import asdict

    from sabench.evaluation.thesis import reproduce as measure
    from sabench.plotting.charts import Figure
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    rows: list[dict[str, Any]] = []
    for row in measure(names, seeds, pixels):
        if isinstance(row, Figure):
            if figures:
                _write_plot(row, figures)
            continue
        rows.append(asdict(row))
        _report_row(rows[-1])
        if output:
            _write_rows(rows, output)
    if as_json:
        say_json(rows)
    else:
        _show_rows(rows)


def _write_plot(plot: Any, folder: Path) -> None:
    from sabench.plotting.drawing import draw
    from sabench.utils.files import complete_or_nothing

    folder.mkdir(parents=True, exist_ok=True)
    with complete_or_nothing(folder / f"{plot.name}.png", overwrite=True) as partial:
        partial.write_bytes(draw(plot))


def _write_rows(rows: list[dict[str, Any]], file: Path) -> None:
    """Write all rows so far, so that an interrupted run keeps them."""
    from sabench.utils.files import canonical_json, complete_or_nothing

    with complete_or_nothing(file, overwrite=True) as partial:
        partial.write_text(canonical_json(rows), encoding="utf-8")


def _report_row(row: dict[str, Any]) -> None:
    from sabench.utils.progress import console

    values = f"{tables.figure(row['measured'])}, thesis {tables.figure(row['thesis'])}"
    console.print(f"{row['name']}: {values}: {row['verdict']}", markup=False, highlight=False)


def _show_rows(rows: list[dict[str, Any]]) -> None:
    """Print the values of the thesis next to the measured ones."""
    cells = []
    for row in rows:
        spread = "" if row["ci95"] is None else f" ± {row['ci95']:.2g}"
        values = [tables.figure(row["thesis"]), tables.figure(row["measured"]) + spread]
        cells.append([row["name"], *values, str(row["seeds"] or "-"), row["verdict"], row["note"]])
    tables.show_wrapped(["row", "thesis", "measured", "seeds", "verdict", "note"], cells)
