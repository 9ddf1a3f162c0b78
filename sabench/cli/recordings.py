"""Command on recordings of other people: compare-statistics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sabench.cli import tables
from sabench.cli.options import AsJson, DataSet, say, say_json

if TYPE_CHECKING:
    from sabench.evaluation.recording_comparison import Measured

# label, key, factor, decimals
ROWS = (
    ("saturated pixels, %", "saturated", 100.0, 3),
    ("background p5, of 255", "background_p5", 1.0, 1),
    ("background p50, of 255", "background_p50", 1.0, 1),
    ("background p95, of 255", "background_p95", 1.0, 1),
    ("dim pixels, fixed, of 255", "fixed", 1.0, 2),
    ("the same, pixel to pixel", "fixed_near", 1.0, 2),
    ("dim pixels, temporal, of 255", "temporal", 1.0, 2),
    ("image width p10, px", "width_p10", 1.0, 2),
    ("image width p50, px", "width_p50", 1.0, 2),
    ("image width p90, px", "width_p90", 1.0, 2),
    ("ln flux, standard deviation", "ln_flux", 1.0, 2),
    ("ln flux ratio of cameras, std", "ln_ratio", 1.0, 2),
    ("the same, robust", "ln_ratio_robust", 1.0, 2),
    ("peaks per pixel", "per_pixel", 1.0, 4),
    ("contrast", "contrast", 1.0, 2),
)


def compare_statistics(
    dataset: DataSet,
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Images (tif, png, bmp) of your cameras, in one folder for each or all in one; or "
            "a data set.",
        ),
    ],
    frames: Annotated[
        int,
        typer.Option(min=1, max=200, metavar="N", help="Images of each camera to read, at most."),
    ] = 20,
    white: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            max=65535.0,
            metavar="DN",
            help="Grey value of a saturated pixel of your images; by default of the bit depth.",
            show_default=False,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a data set's images with your own recordings.

    Light, noise, and widths and brightness of particle images, as medians over the cameras.
    """
    from sabench.dataset.reader import open_dataset
    from sabench.evaluation.recording_comparison import measure, measure_dataset

    data = open_dataset(dataset)
    both = measure_dataset(data, frames), measure(recording, frames, white)
    if as_json:
        say_json(dict(zip(("dataset", "recording"), (one.to_json() for one in both), strict=True)))
        return
    columns = [one.medians() for one in both]
    rows = [
        (label, *(cell(one.get(key), factor, decimals) for one in columns))
        for label, key, factor, decimals in ROWS
    ]
    tables.show(("median over the cameras", "data set", "recording"), rows)
    for name, one in zip(("data set", "recording"), both, strict=True):
        say(f"{name}: {_describe(one)}")


def cell(value: float | None, factor: float, decimals: int) -> str:
    """Format a figure of the table, a missing one as a dash."""
    return tables.format_number(None if value is None else factor * value, decimals)


def _describe(measured: Measured) -> str:
    low, high = min(measured.white_dn.values()), max(measured.white_dn.values())
    white = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    size = f"cameras: {len(measured.cameras)}, images of each: {measured.frames}, white: {white}"
    if measured.ratio is None:
        return f"{size}\n  flux ratios: they need a calibration"
    return f"{size}\n  flux ratios: {measured.ratio.pairs}, matched by {measured.matched}"
