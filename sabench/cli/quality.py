"""Command on results without truth: quality."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, DataSet, Overwrite, say, say_json

if TYPE_CHECKING:
    from sabench.tasks.quality import Quality


def quality(
    dataset: DataSet,
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A result file of particles or volumes.")
    ],
    frames: Annotated[
        int, typer.Option(min=1, metavar="N", help="Compare the first N frames with their images.")
    ] = 1,
    again: Annotated[
        bool,
        typer.Option(
            "--again/--no-again",
            help="Run the solver again without each camera, and with each one scrambled.",
        ),
    ] = True,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="Folder to create, with quality.json and residuals.png.",
        ),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Judge a result by the images that it came from, without truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.quality import quality as judge, write_quality
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    if result.is_file():
        probe(result)
    judged = judge(dataset, result, frames=frames, solve_again=again)
    if output is not None:
        write_quality(dataset, judged, output, overwrite=overwrite)
    if as_json:
        say_json({"figures": judged.figures, "cameras": judged.cameras, "notes": judged.notes})
    else:
        _show(judged)


def _show(judged: Quality) -> None:
    from sabench.tasks.quality_figures import FIGURES

    known = {key: one for key, one in FIGURES.items() if judged.figures[key] is not None}
    rows = [
        (key, tables.format_number(judged.figures[key], one.decimals), one.meaning)
        for key, one in known.items()
    ]
    tables.show(("figure", "value", "meaning"), rows)
    of_cameras = [key for key in known if any(key in one for one in judged.cameras.values())]
    lines = [
        (name, *(tables.format_number(one.get(key), known[key].decimals) for key in of_cameras))
        for name, one in judged.cameras.items()
    ]
    tables.show(("camera", *of_cameras), lines)
    for note in judged.notes:
        say(f"note: {note}")
