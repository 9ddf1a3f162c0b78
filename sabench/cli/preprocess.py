"""Command that previews preprocessing: preprocess."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, Overwrite, parse_steps, say, say_json

if TYPE_CHECKING:
    from sabench.dataset.preprocessing_preview import Preview, Stage


def preprocess(
    source: Annotated[
        Path, typer.Argument(metavar="DATASET", help="A data set folder, or an image file.")
    ],
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Name or number of the camera; by default the first one.",
            show_default=False,
        ),
    ] = None,
    frame: Annotated[
        int, typer.Option(min=0, metavar="N", help="Frame, or page of an image file.")
    ] = 0,
    step: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[,KEY=VALUE]",
            help="Step of preprocessing, as in sliding_minimum,window_px=9; repeatable. By default "
            "the steps of the data set.",
        ),
    ] = None,
    false_alarms: Annotated[
        float,
        typer.Option(
            min=1e-12, max=0.1, metavar="P", help="Probability that noise makes a peak of a pixel."
        ),
    ] = 1e-5,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="The PNG file to create."),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Preview the steps of preprocessing on one image, with the peaks in it."""
    from sabench.dataset.preprocessing_preview import preview, preview_figure
    from sabench.plotting.drawing import draw
    from sabench.utils.files import complete_or_nothing, refuse_existing

    if output is not None:
        refuse_existing(output, overwrite=overwrite)
    shown = preview(
        source,
        camera=camera,
        frame=frame,
        steps=parse_steps(step) if step else None,
        false_alarms=false_alarms,
    )
    if output is not None:
        with complete_or_nothing(output, overwrite=overwrite) as file:
            file.write_bytes(draw(preview_figure(shown)))
    if as_json:
        say_json([_record(one, false_alarms) for one in shown.stages])
    else:
        _show(shown, false_alarms, output)


def _record(stage: Stage, false_alarms: float) -> dict[str, object]:
    return {
        "step": stage.name,
        "black": stage.black_dn,
        "noise": stage.noise_dn,
        "noise_least": float(stage.dark.noise.min()),
        "noise_most": float(stage.dark.noise.max()),
        "threshold": stage.threshold_dn,
        "false_alarms": false_alarms,
        "peaks": len(stage.peaks),
        "false_peaks_at_most": stage.expected_false,
    }


def _show(shown: Preview, false_alarms: float, output: Path | None) -> None:
    say(shown.title)
    tables.show(
        ("after", "black", "noise", "threshold", "peaks", "false at most"),
        [
            (
                one.name,
                f"{one.black_dn:.1f}",
                f"{one.noise_dn:.2f}",
                f"{one.threshold_dn:.1f}",
                f"{len(one.peaks)}",
                f"{one.expected_false:.1f}",
            )
            for one in shown.stages
        ],
    )
    say(
        f"black, noise and threshold: medians over the pixels; false alarms: {false_alarms:g} per "
        "pixel at most"
    )
    if output is not None:
        say(f"{output}: pictures after each step; circles mark peaks")
