"""Command on your own recordings: import."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from sabench.cli import tables
from sabench.cli.exchange import notes_shown
from sabench.cli.options import AsJson, Overwrite, parse_steps, say, say_json
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from sabench.dataset.import_recording import Box, Imported
    from sabench.geometry.grid import Grid
    from sabench.images.image_reading import RawLayout
    from sabench.interop.cameras import CameraFormat


def import_recording(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="A folder of images.")],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FOLDER", help="The data set folder to create."),
    ],
    cameras: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="The calibration: a folder that `sabench calibrate` has written, a cameras.json, "
            "a data set, or with --from another program's; by default FOLDER itself.",
            show_default=False,
        ),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="FORMAT",
            help="The program whose calibration it is: openptv, myptv, openlpt, opencv, matlab or "
            "lpt-challenge; by default sabench.",
            show_default=False,
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            metavar="UNIT",
            help="Unit of that program's lengths: mm, m, um ...; by default mm.",
            show_default=False,
        ),
    ] = None,
    pattern: Annotated[
        str | None,
        typer.Option(
            metavar="PATTERN",
            help="Path of an image in the folder, as in '{camera}/img_{frame}.tif'; * stands for "
            "anything.",
        ),
    ] = None,
    pair: Annotated[
        list[str] | None,
        typer.Option(
            metavar="IMAGES=CAMERA",
            help="Name of a camera's images and of its calibration; repeatable. Others are left "
            "out.",
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="START:STOP", help="Take these images of each camera only; the first one is 0."
        ),
    ] = None,
    interval: Annotated[
        float, typer.Option(min=1e-12, metavar="SECONDS", help="Time between frames.")
    ] = 1.0,
    pulses: Annotated[
        int, typer.Option(min=1, metavar="N", help="Frames in a group: 2 for double frames.")
    ] = 1,
    period: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Time from group to group.", show_default=False),
    ] = None,
    volume: Annotated[
        str | None,
        typer.Option(
            metavar="X0,X1,Y0,Y1,Z0,Z1",
            help="The box that is lit, mm; by default what all cameras see.",
            show_default=False,
        ),
    ] = None,
    voxel: Annotated[
        float | None,
        typer.Option(
            metavar="MM", help="Size of voxels; by default that of a pixel.", show_default=False
        ),
    ] = None,
    black: Annotated[
        float | None,
        typer.Option(
            metavar="DN",
            help="Grey value of no light; by default estimated for each camera.",
            show_default=False,
        ),
    ] = None,
    white: Annotated[
        float | None,
        typer.Option(
            metavar="DN",
            help="Grey value of saturation; by default estimated for each camera.",
            show_default=False,
        ),
    ] = None,
    masks: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Images by the cameras' names; 0 leaves pixels out."),
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[,KEY=VALUE]",
            help="Step of preprocessing, as in sliding_minimum,window_px=9; repeatable.",
        ),
    ] = None,
    backlit: Annotated[
        bool, typer.Option("--backlit", help="The images show bubbles or bodies, not particles.")
    ] = False,
    raw: Annotated[
        str | None,
        typer.Option(
            metavar="TYPE[,HEADER]",
            help="Pixels of raw files: uint8, uint16 or uint16-big, and bytes of their header.",
        ),
    ] = None,
    reference: Annotated[
        bool,
        typer.Option("--reference", help="Leave the images where they are, and do not copy them."),
    ] = False,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Make a data set without truth of your own images and calibration."""
    from sabench.dataset.import_recording import ImportOptions, import_recording as make
    from sabench.interop.camera_sources import read_camera_source

    options = ImportOptions(
        pattern=pattern,
        pairs=_pairs(pair),
        frames=_frames(frames),
        raw=_raw(raw),
        masks=masks,
        volume_mm=_box(volume),
        voxel_mm=voxel,
        interval_s=interval,
        pulses=pulses,
        period_s=period,
        black_dn=black,
        white_dn=white,
        preprocessing=parse_steps(step or []),
        backlit=backlit,
        referenced=reference,
    )
    size = _first_size(folder, pattern) if form else None
    lit = None if options.volume_mm is None else _grid(options.volume_mm)
    with notes_shown():  # the reader checks the word
        source = read_camera_source(
            cameras or folder, cast("CameraFormat | None", form), unit=unit, size=size, grid=lit
        )
    made = make(folder, source.cameras, output, options, source.grid, overwrite=overwrite)
    if as_json:
        say_json(_import_record(made))
    else:
        _show_import(made, output)


def _show_import(made: Imported, out: Path) -> None:
    rows = [
        (
            name,
            f"{level.black_dn:.1f}",
            f"{level.white_dn:g}",
            f"{level.bit_depth}",
            f"{100.0 * level.saturated:.3f}",
        )
        for name, level in made.levels.items()
    ]
    tables.show(("camera", "black", "white", "bits", "saturated %"), rows)
    grid = made.grid
    x, y, z = (
        f"{low - step / 2:.4g} to {low + step * (count - 0.5):.4g}"
        for low, step, count in zip(grid.low_mm, grid.voxel_mm, grid.shape[::-1], strict=True)
    )
    voxels = " x ".join(f"{edge:.4g}" for edge in grid.voxel_mm)
    say(f"volume: x {x}, y {y}, z {z} mm; voxels of {voxels} mm")
    for note in made.notes:
        say(f"note: {note}")
    say(f"{out}: {made.frames} frame(s) of {len(made.levels)} camera(s), recorded, without truth")


def _import_record(made: Imported) -> dict[str, object]:
    from dataclasses import asdict

    return {
        "frames": made.frames,
        "cameras": {name: asdict(level) for name, level in made.levels.items()},
        "grid": asdict(made.grid),
        "notes": made.notes,
    }


def _pairs(words: list[str] | None) -> dict[str, str] | None:
    if not words:
        return None
    parted = [word.partition("=") for word in words]
    if not all(of and own for of, _, own in parted):
        raise InputError(f"--pair: expected IMAGES=CAMERA, got {', '.join(words)}")
    return {of: own for of, _, own in parted}


def _numbers(option: str, text: str, expected: str, count: int) -> list[float]:
    try:
        values = [float(one) for one in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(f"{option}: expected {expected}, got {text!r}")
    return values


def _first_size(folder: Path, pattern: str | None) -> tuple[int, int] | None:
    """Return rows and columns of the first image, which some calibrations leave out."""
    from sabench.images.image_files import find_image_files
    from sabench.images.image_reading import image_size

    files = find_image_files(folder, [], pattern)
    return image_size(next(iter(files.values()))[0])


def _box(text: str | None) -> Box | None:
    if text is None:
        return None
    x0, x1, y0, y1, z0, z1 = _numbers("--volume", text, "x0,x1,y0,y1,z0,z1 in mm", 6)
    return x0, x1, y0, y1, z0, z1


def _grid(box: Box) -> Grid:
    """Make a grid of a box, of a thousand voxels or so."""
    import numpy as np

    from sabench.geometry.common_view import grid_of_box

    low, high = np.array(box[::2]), np.array(box[1::2])
    return grid_of_box(low, high, float(np.cbrt(np.prod(high - low) / 1000.0)))


def _frames(text: str | None) -> slice:
    if text is None:
        return slice(None)
    try:
        parts = [int(one) if one else None for one in text.split(":")]
    except ValueError:
        parts = []
    if not 2 <= len(parts) <= 3 or any(one is not None and one < 0 for one in parts):
        raise InputError(f"--frames: expected START:STOP or START:STOP:STEP, got {text!r}")
    return slice(*parts)


def _raw(text: str | None) -> RawLayout | None:
    from sabench.images.image_reading import RawLayout

    if text is None:
        return None
    dtype, _, header = text.partition(",")
    if header and not header.isdigit():
        raise InputError(f"--raw: expected TYPE or TYPE,HEADER in bytes, got {text!r}")
    return RawLayout(dtype, int(header or 0))
