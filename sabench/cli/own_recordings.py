"""Commands on your own recordings: calibrate, preprocess, compare-statistics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sabench import plugins
from sabench.cli import options, tables
from sabench.cli.options import AsJson, Overwrite, argument, option, output_option, say, say_json
from sabench.utils.number_text import format_number

if TYPE_CHECKING:
    from sabench.apps.recordings import Measured
    from sabench.dataset.preprocessing_preview import PreviewStage


def calibrate(
    folder: Annotated[
        Path,
        argument(
            "FOLDER",
            "A folder with calibration.toml and images or points.csv "
            "(see docs/using/calibrating.md).",
        ),
    ],
    output: Annotated[
        Path | None,
        output_option("FOLDER", "The folder to create. [default: result, in that folder]"),
    ] = None,
    solver: Annotated[
        str,
        option(
            "NAME",
            "Name of a calibration solver.",
            autocompletion=options.complete(lambda: plugins.list_solvers("calibration")),
        ),
    ] = "refractive_autocal",
    parameter: options.ParameterPairs = None,
    unknowns: Annotated[
        str | None,
        option(
            "NAMES",
            "Unknowns besides the focal lengths, separated by commas, in place of those of "
            "calibration.toml; or auto: those that make held-out frames fit better.",
        ),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Calibrate your own cameras from images or points of a target."""
    from dataclasses import asdict

    from sabench.apps.own_calibration.calibrate import calibrate as make

    options.announce_compiling()
    out = output or folder / "result"
    values = options.parse_parameters(parameter)
    report = make(folder, out, solver, values, unknowns=unknowns, overwrite=overwrite)
    if as_json:
        say_json(asdict(report))
    else:
        say(repr(report))
        say(f"{out}: cameras.json, report.json, target.csv, errors.png, residuals/")


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
    dataset: options.DataSet,
    recording: Annotated[
        Path,
        argument(
            "FOLDER",
            "Images (tif, png, bmp) of your cameras, a folder each or one for all; or a data set.",
        ),
    ],
    frames: Annotated[int, option("N", "Images of each camera, at most.", min=1, max=200)] = 20,
    white: Annotated[
        float | None,
        option(
            "DN",
            "Grey value of a saturated pixel of your images; by default of the bit depth.",
            min=1.0,
            max=65535.0,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a data set's images with your own recordings.

    Light, noise, and widths and brightness of particle images, as medians over the cameras.
    """
    from sabench.apps.recordings import measure, measure_dataset
    from sabench.dataset.reader import open_dataset

    data = open_dataset(dataset)
    both = measure_dataset(data, frames), measure(recording, frames, white)
    if as_json:
        say_json({"dataset": both[0].to_json(), "recording": both[1].to_json()})
        return
    columns = [source.medians() for source in both]
    rows = [
        (label, *(cell(column.get(key), factor, decimals) for column in columns))
        for label, key, factor, decimals in ROWS
    ]
    tables.show(("median over the cameras", "data set", "recording"), rows)
    for name, source in zip(("data set", "recording"), both, strict=True):
        say(f"{name}: {_describe(source)}")


def cell(value: float | None, factor: float, decimals: int) -> str:
    """Format a figure of the table, a missing one as a dash."""
    return format_number(None if value is None else factor * value, decimals)


def _describe(measured: Measured) -> str:
    low, high = min(measured.white_dn.values()), max(measured.white_dn.values())
    white = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    size = f"cameras: {len(measured.cameras)}, images of each: {measured.frames}, white: {white}"
    if measured.ratio is None:
        return f"{size}\n  flux ratios: they need a calibration"
    return f"{size}\n  flux ratios: {measured.ratio.pairs}, matched by {measured.matched}"


def preprocess(
    source: Annotated[Path, argument("DATASET", "A data set folder, or an image file.")],
    camera: Annotated[
        str | None, option("NAME", "Name or number of the camera; by default the first one.")
    ] = None,
    frame: Annotated[int, option("N", "Frame, or page of an image file.", min=0)] = 0,
    step: Annotated[
        list[str] | None,
        option("NAME[,KEY=VALUE]", f"{options.STEP} [default: those of the data set]"),
    ] = None,
    false_alarms: Annotated[
        float, option("P", "Probability that noise makes a peak of a pixel.", min=1e-12, max=0.1)
    ] = 1e-5,
    output: Annotated[Path | None, output_option("FILE", "The PNG file to create.")] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Preview the steps of preprocessing on one image, with the peaks in it."""
    from sabench.dataset.preprocessing_preview import preview
    from sabench.utils.files import complete_or_nothing, refuse_existing

    if output is not None:
        refuse_existing(output, overwrite=overwrite)
    steps = options.parse_steps(step) if step else None
    shown = preview(source, camera=camera, frame=frame, steps=steps, false_alarms=false_alarms)
    if output is not None:
        with complete_or_nothing(output, overwrite=overwrite) as file:
            file.write_bytes(shown._picture())
    if as_json:
        say_json([_record(stage, false_alarms) for stage in shown.stages])
    else:
        say(f"{shown!r}\nfalse alarms: {false_alarms:g} per pixel at most")
        if output is not None:
            say(f"{output}: pictures after each step; circles mark peaks")


def _record(stage: PreviewStage, false_alarms: float) -> dict[str, object]:
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
