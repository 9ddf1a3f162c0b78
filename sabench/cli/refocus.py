"""Command that refocuses a frame on a surface: refocus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from sabench.cli.options import AsJson, DataSet, Overwrite, parse_parameters, say, say_json

if TYPE_CHECKING:
    from sabench.algorithms.refocus import Join


def refocus(
    dataset: DataSet,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FOLDER", help="The folder to create.")
    ],
    surface: Annotated[
        str, typer.Option(metavar="NAME", help="Surface: plane, cylinder or height_map.")
    ] = "plane",
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "-p",
            "--parameter",
            metavar="NAME=VALUE",
            help="Set a parameter of the surface, as in center_mm=[0,0,170], turn_deg=[0,20,0], "
            "radius_mm=40 or file=wall.csv; repeatable.",
        ),
    ] = None,
    join: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How views are joined: additive, multiplicative, dark, minimum, maximum or "
            "median.",
        ),
    ] = "additive",
    frame: Annotated[int, typer.Option(min=0, metavar="N", help="Frame, from 0.")] = 0,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Refocus one frame on a plane, a cylinder or a height map."""
    from sabench.dataset.verification import probe_dataset
    from sabench.tasks.surface_refocusing import refocus as make

    probe_dataset(dataset)
    made = make(
        dataset,
        output,
        surface,
        parse_parameters(parameter),
        join=cast("Join", join),  # `make` checks the word
        frame=frame,
        overwrite=overwrite,
    ).summary
    if as_json:
        say_json(made)
        return
    say(
        f"{output}: {surface} of {made['rows']} x {made['columns']} pixels of "
        f"{made['pixel_mm']:g} mm, {made['seen_percent']:.1f} % seen, by {made['views_mean']:.1f} "
        "cameras on average: image.exr, image.png, points.exr, surface.json"
    )
