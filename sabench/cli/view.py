"""Command that shows a rig, a data set or a result in space: view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sabench.cli.options import AsJson, Overwrite, complete_scene, say, say_json


def view(
    what: Annotated[
        str,
        typer.Argument(
            metavar="RIG|DATASET|RESULT",
            help="A scene file or the name of a bundled scene; cameras.json; a data set; or a "
            "result file next to its data set.",
            autocompletion=complete_scene,
        ),
    ],
    result: Annotated[
        Path | None,
        typer.Argument(metavar="RESULT", help="A result file of the data set."),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The page to create.")
    ] = Path("view.html"),
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Show a rig, a data set or a result in space, as one page for any browser.

    The page shows cameras and their light paths, the wall, the light, particles that were found and
    missed, ghosts, trajectories, refocused planes and every camera's image. It needs no network.
    """
    from sabench.evaluation.viewer.view import view as make
    from sabench.utils.files import refuse_existing
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    refuse_existing(output, overwrite=overwrite)
    made = make(what, result)
    made.save(output, overwrite=overwrite)
    if as_json:
        say_json({"page": str(output), **made.summary, "notes": made.notes})
        return
    shown = made.summary
    say(
        f"{output}: {shown['cameras']} camera(s), {shown['frames']} frame(s), {shown['particles']} "
        f"particles, {shown['bubbles']} bubbles, {shown['bytes'] / 1e6:.1f} MB"
    )
    for note in made.notes:
        say(f"note: {note}")
