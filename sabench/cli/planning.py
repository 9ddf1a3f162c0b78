"""Command that plans an experiment: plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, Overwrite, SceneName, say, say_json

if TYPE_CHECKING:
    from sabench.evaluation.planning.plan import Plan


def plan(
    scene: SceneName,
    page: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="FILE", help="Write the plan with drawings of the rig as a page."
        ),
    ] = None,
    bus_mb_s: Annotated[
        float, typer.Option(metavar="X", help="Transfer rate of one bus, MB/s.")
    ] = 80.0,
    memory_gb: Annotated[
        float, typer.Option(metavar="X", help="Memory for the images of a recording, GB.")
    ] = 8.0,
    gap_us: Annotated[
        float, typer.Option(metavar="X", help="Shortest time between two exposures, us.")
    ] = 250.0,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Plan an experiment: resolution, depth, light, density and data rate of a scene."""
    from sabench.evaluation.planning.plan import plan as make
    from sabench.evaluation.planning.recording import Recorder
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    made = make(scene, Recorder(bus_mb_s, memory_gb, gap_us))
    if page is not None:
        _write_page(made, page, overwrite=overwrite)
    if as_json:
        say_json(made.to_dict())
    else:
        _show(made)


def _write_page(made: Plan, file: Path, *, overwrite: bool) -> None:
    from sabench.evaluation.planning.page import render
    from sabench.utils.files import complete_or_nothing

    with complete_or_nothing(file, overwrite=overwrite) as partial:
        partial.write_text(render(made), encoding="utf-8")


def _show(made: Plan) -> None:
    rows = [
        (
            section.title if number == 0 else "",
            one.key,
            one.text,
            one.meaning,
            one.source,
        )
        for section in made.sections
        for number, one in enumerate(section.quantities)
    ]
    say(made.scene.title)
    tables.show_wrapped(("", "figure", "value", "meaning", "equation or source"), rows)
    for advice in made.advice:
        say(f"warning: {advice.key}: {advice.sentence}")
