"""Command that plans an experiment: plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, Overwrite, complete_scene, say, say_json
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from sabench.evaluation.planning.plan import Plan
    from sabench.scenes import Scene

_BASE = "standard-particles"  # scene that a design changes


def plan(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            help="A scene file, or the name of a bundled scene; with --depth, the scene to change.",
            autocompletion=complete_scene,
        ),
    ] = None,
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
    depth: Annotated[
        float | None, typer.Option(metavar="X", help="Wanted depth of the volume, mm.")
    ] = None,
    density: Annotated[
        float | None, typer.Option(metavar="X", help="Wanted density, particles per mm3.")
    ] = None,
    resolution: Annotated[
        float | None, typer.Option(metavar="X", help="Wanted width of a pixel in the volume, mm.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write the scene that is wanted."),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Plan an experiment: resolution, depth, light, density and data rate of a scene."""
    from sabench.evaluation.planning.plan import plan as make
    from sabench.evaluation.planning.recording import Recorder
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    recorder = Recorder(bus_mb_s, memory_gb, gap_us)
    wanted = {"depth": depth, "density": density, "resolution": resolution, "output": output}
    if any(value is not None for value in wanted.values()):
        made = make(_design(scene, wanted, overwrite=overwrite), recorder)
    elif scene is None:
        raise InputError("SCENE: expected a scene file, or the name of a bundled scene, got none")
    else:
        made = make(scene, recorder)
    if page is not None:
        _write_page(made, page, overwrite=overwrite)
    if as_json:
        say_json(made.to_dict())
    else:
        _show(made)
        if output is not None:
            say(f"{output}: the scene that is wanted")
        if page is not None:
            say(f"{page}: the plan with drawings")


def _design(scene: str | None, wanted: dict[str, Any], *, overwrite: bool) -> Scene:
    """Design a scene and write it."""
    from sabench.evaluation.planning.design import Wanted, design_scene
    from sabench.scenes import load_scene
    from sabench.utils.files import complete_or_nothing, refuse_existing

    if missing := [f"--{name}" for name, value in wanted.items() if value is None]:
        raise InputError(f"{', '.join(missing)}: expected next to the other options of a design")
    refuse_existing(wanted["output"], overwrite=overwrite)
    numbers = Wanted(wanted["depth"], wanted["density"], wanted["resolution"])
    designed = design_scene(load_scene(scene or _BASE), numbers)
    with complete_or_nothing(wanted["output"], overwrite=overwrite) as partial:
        partial.write_text(designed.to_toml(), encoding="utf-8")
    return designed


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
