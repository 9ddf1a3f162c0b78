"""Command on Belden's thesis: reproduce."""

from pathlib import Path
from typing import Annotated

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, argument, option, say_json
from sabench.utils.number_text import significant


def reproduce(
    names: Annotated[
        list[str] | None,
        argument(
            "NAME...",
            "What to measure: table-2-1, fig-2-6, ... or all; an unknown name lists them.",
        ),
    ] = None,
    as_list: Annotated[
        bool,
        typer.Option(
            "--list", help="List all tables and figures of the thesis with recorded verdicts."
        ),
    ] = False,
    as_json: AsJson = False,
    seeds: Annotated[int | None, option("N", "Number of seeds to average over.", min=1)] = None,
    pixels: Annotated[
        int | None,
        option(
            "N",
            "Use small images of this size for a quick trial; the results are not comparable.",
            min=32,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        option(
            "FILE",
            "Write each name's rows to a JSON file when it is done; other rows stay.",
            "-o",
            "--output",
        ),
    ] = None,
    figures: Annotated[
        Path | None, option("FOLDER", "Write plots of the curves, and a page of all values.")
    ] = None,
) -> None:
    """Reproduce tables and figures of Belden's thesis and compare the values."""
    from sabench.evaluation.reproduction import load_reproduction
    from sabench.utils.errors import InputError

    if as_list and names:
        raise InputError(f"reproduce: expected no names beside --list, got {names[0]}")
    if as_list:
        catalogue = load_reproduction("catalogue")
        entries = catalogue.judged(catalogue.read_rows(catalogue.MEASURED))
        if as_json:
            say_json(entries)
            return
        cells = [[row["name"], row["shows"], row["verdict"], row["item"]] for row in entries]
        tables.show_wrapped(["name", "shows", "verdict", "measured by"], cells)
    elif names:
        rows = load_reproduction("report").measure(names, seeds, pixels, output, figures)
        if as_json:
            say_json(rows)
            return
        cells = []
        for row in rows:
            spread = "" if row["ci95"] is None else f" ± {row['ci95']:.2g}"
            values = [significant(row["thesis"]), significant(row["measured"]) + spread]
            seeded = str(row["seeds"] or "-")
            cells.append([row["name"], *values, seeded, row["verdict"], row["note"]])
        tables.show_wrapped(["row", "thesis", "measured", "seeds", "verdict", "note"], cells)
    else:
        raise InputError("reproduce: expected names of tables and figures, all, or --list")
