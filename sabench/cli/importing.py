"""Commands that exchange data with other programs: import, export, import-result."""

from __future__ import annotations

import contextlib
import inspect
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from sabench.cli import options
from sabench.cli.options import AsJson, Overwrite, argument, option, output_option, say, say_json
from sabench.utils.errors import MOST, InputError

if TYPE_CHECKING:
    from sabench.dataset.import_recording import Box, ImportedRecording
    from sabench.geometry.grid import Grid
    from sabench.images.image_reading import RawLayout
    from sabench.interop.cameras import CameraFormat
    from sabench.interop.export import Format
    from sabench.interop.tracks import TrackFormat


def export(
    dataset: options.DataSet,
    result: Annotated[Path | None, argument("RESULT", "A result file; by default none.")] = None,
    output: Annotated[
        Path | None,
        output_option("FOLDER", "The folder to create. [default: the name of the format]"),
    ] = None,
    to: Annotated[
        str,
        option(
            "FORMAT",
            "vtk, netcdf, mat, npy or csv: the truth or a result; openptv, myptv, openlpt or "
            "lpt-challenge: cameras and images, or cameras and a result; coco: boxes and masks of "
            "bubbles.",
        ),
    ] = "vtk",
    overwrite: Overwrite = False,
) -> None:
    """Write a data set or a result for other programs.

    It says what the format cannot carry.
    """
    from sabench.interop.export import export as write

    with notes_shown():  # `write` checks the word
        out = write(dataset, output or Path(to), result, to=cast("Format", to), overwrite=overwrite)
    names = sorted(path.name for path in out.iterdir())
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    say(f"{out}: {', '.join(names[:MOST])}{more}")


def import_result(
    dataset: options.DataSet,
    found: Annotated[Path, argument("FOUND", "The file or folder that the program wrote.")],
    output: Annotated[Path, output_option("RESULT", "The result file to create.")],
    form: Annotated[
        str,
        option("FORMAT", "openptv, myptv, openlpt, lpt-challenge, netcdf, mat, npy, csv", "--from"),
    ],
    task: Annotated[str | None, option("TASK", "particles or bubbles. [default: as shown]")] = None,
    columns: Annotated[
        str | None,
        option("NAME,...", "Names of a table's columns, as in frame,x,y,z,radius."),
    ] = None,
    unit: Annotated[
        str | None, option("UNIT", "As in mm, m, um. [default: the files', or mm]")
    ] = None,
    first: Annotated[
        int | None,
        option("N", "Number of the data set's frame 0 in the files. [default: the smallest]"),
    ] = None,
    name: Annotated[str | None, option("NAME", "Name of the solver. [default: the format]")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Make a result file of particles or bubbles that another program found.

    `sabench score` and all other commands take it.
    """
    from sabench.interop.tracks import import_result as make

    with notes_shown():
        file = make(
            dataset,
            found,
            output,
            cast("TrackFormat", form),  # `make` checks the word
            task=task,
            columns=[column.strip() for column in columns.split(",")] if columns else (),
            unit=unit,
            first=first,
            solver=name,
            overwrite=overwrite,
        )
    tracks = "no" if file.trajectories is None else str(file.trajectories)
    say(f"{file.path}: {file.found} {file.task} in {file.frames} frames, {tracks} trajectories")


@contextlib.contextmanager
def notes_shown() -> Iterator[None]:
    """Print the warnings about foreign formats, each as one line on standard error."""
    from sabench.interop.foreign import ForeignFormatWarning

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ForeignFormatWarning)
        try:
            yield
        finally:
            for warning in caught:
                print(f"note: {warning.message}", file=sys.stderr)


def _pairs(words: list[str]) -> dict[str, str]:
    parted = [word.partition("=") for word in words]
    if not all(of and camera for of, _, camera in parted):
        raise InputError(f"--pair: expected IMAGES=CAMERA, got {', '.join(words)}")
    return {of: camera for of, _, camera in parted}


def _numbers(flag: str, text: str, expected: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(f"{flag}: expected {expected}, got {text!r}")
    return values


def _box(text: str) -> Box:
    x0, x1, y0, y1, z0, z1 = _numbers("--volume", text, "x0,x1,y0,y1,z0,z1 in mm", 6)
    return x0, x1, y0, y1, z0, z1


def _frames(text: str) -> slice:
    try:
        parts = [int(part) if part else None for part in text.split(":")]
    except ValueError:
        parts = []
    if not 2 <= len(parts) <= 3 or any(part is not None and part < 0 for part in parts):
        raise InputError(f"--frames: expected START:STOP or START:STOP:STEP, got {text!r}")
    return slice(*parts)


def _raw(text: str) -> RawLayout:
    from sabench.images.image_reading import RawLayout

    dtype, _, header = text.partition(",")
    if header and not header.isdigit():
        raise InputError(f"--raw: expected TYPE or TYPE,HEADER in bytes, got {text!r}")
    return RawLayout(dtype, int(header or 0))


@dataclass(frozen=True)
class _Key:
    """Option of `import` that is a key of `ImportOptions`; `read` converts its value.

    A default of None means that of `ImportOptions`.
    """

    flag: str
    kind: Any
    metavar: str | None
    help: str
    default: Any = None
    least: float | None = None
    read: Callable[[Any], Any] | None = None


def _with_keys(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `_KEYS` in place of its parameter `keys`."""
    bare = inspect.signature(command, eval_str=True)
    before = [arg for arg in bare.parameters.values() if arg.kind is arg.POSITIONAL_OR_KEYWORD]
    after = [arg for arg in bare.parameters.values() if arg.kind is arg.KEYWORD_ONLY]
    keys = []
    for name, key in _KEYS.items():
        declared = option(key.metavar, key.help, key.flag, min=key.least)
        given = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=key.default)
        keys.append(given.replace(annotation=Annotated[key.kind, declared]))
    signature = bare.replace(parameters=[*before, *keys, *after])
    command.__signature__ = signature  # type: ignore[attr-defined]
    command.__annotations__ = {arg.name: arg.annotation for arg in signature.parameters.values()}
    return command


# fmt: off
_KEYS = {
    "pattern": _Key("--pattern", str | None, "PATTERN", "Path of an image in the folder, as in "
                    "'{camera}/img_{frame}.tif'; * stands for anything."),
    "pairs": _Key("--pair", list[str] | None, "IMAGES=CAMERA", "Name of a camera's images and of "
                  "its calibration; repeatable. Others are left out.", read=_pairs),
    "frames": _Key("--frames", str | None, "START:STOP", "Take these images of each camera only; "
                   "the first one is 0.", read=_frames),
    "interval_s": _Key("--interval", float, "SECONDS", "Time between frames.", 1.0, 1e-12),
    "pulses": _Key("--pulses", int, "N", "Frames in a group: 2 for double frames.", 1, 1),
    "period_s": _Key("--period", float | None, "SECONDS", "Time from group to group."),
    "volume_mm": _Key("--volume", str | None, "X0,X1,Y0,Y1,Z0,Z1", "The box that is lit, mm; by "
                      "default what all cameras see.", read=_box),
    "voxel_mm": _Key("--voxel", float | None, "MM", "Size of voxels; by default that of a pixel."),
    "black_dn": _Key("--black", float | None, "DN", "Grey value of no light; by default estimated "
                     "for each camera."),
    "white_dn": _Key("--white", float | None, "DN", "Grey value of saturation; by default "
                     "estimated for each camera."),
    "masks": _Key("--masks", Path | None, "FOLDER", "Images by the cameras' names; 0 leaves "
                  "pixels out."),
    "preprocessing": _Key("--step", list[str] | None, "NAME[,KEY=VALUE]", options.STEP,
                          read=options.parse_steps),
    "backlit": _Key("--backlit", bool, None, "The images show bubbles or bodies, not particles.",
                    False),
    "raw": _Key("--raw", str | None, "TYPE[,HEADER]", "Pixels of raw files: uint8, uint16 or "
                "uint16-big, and bytes of their header.", read=_raw),
    "referenced": _Key("--reference", bool, None, "Leave the images where they are, and do not "
                       "copy them.", False),
}
# fmt: on


@_with_keys
def import_recording(
    folder: Annotated[Path, argument("FOLDER", "A folder of images.")],
    output: Annotated[Path, output_option("FOLDER", "The data set folder to create.")],
    cameras: Annotated[
        Path | None,
        option(
            "PATH",
            "The calibration: a folder that `sabench calibrate` has written, a cameras.json, "
            "a data set, or with --from another program's; by default FOLDER itself.",
        ),
    ] = None,
    form: Annotated[
        str | None,
        option(
            "FORMAT",
            "The program whose calibration it is: openptv, myptv, openlpt, opencv, matlab or "
            "lpt-challenge; by default sabench.",
            "--from",
        ),
    ] = None,
    unit: Annotated[
        str | None, option("UNIT", "Unit of that program's lengths: mm, m, um ...; by default mm.")
    ] = None,
    *,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
    **keys: Any,
) -> None:
    """Make a data set without truth of your own images and calibration."""
    from sabench.dataset.import_recording import ImportOptions, import_recording as make
    from sabench.interop.cameras import read_camera_source

    given = {name: value for name, value in keys.items() if value not in (None, [])}
    readers = {name: key.read for name, key in _KEYS.items() if key.read}
    chosen = ImportOptions(
        **{name: readers[name](text) if name in readers else text for name, text in given.items()}
    )
    size = _first_size(folder, chosen.pattern) if form else None
    lit = None if chosen.volume_mm is None else _grid(chosen.volume_mm)
    with notes_shown():  # the reader checks the word
        source = read_camera_source(
            cameras or folder, cast("CameraFormat | None", form), unit=unit, size=size, grid=lit
        )
    data = make(folder, source.cameras, output, chosen, source.grid, overwrite=overwrite)
    if as_json:
        say_json(_import_record(data))
    else:
        say(f"{output}: {data!r}")


def _import_record(data: ImportedRecording) -> dict[str, object]:
    from dataclasses import asdict

    return {
        "frames": data.frames,
        "cameras": {name: asdict(level) for name, level in data.levels.items()},
        "grid": asdict(data.grid),
        "notes": data.notes,
    }


def _first_size(folder: Path, pattern: str | None) -> tuple[int, int] | None:
    """Return rows and columns of the first image, which some calibrations leave out."""
    from sabench.images.image_files import find_image_files
    from sabench.images.image_reading import image_size

    files = find_image_files(folder, [], pattern)
    return image_size(next(iter(files.values()))[0])


def _grid(box: Box) -> Grid:
    import numpy as np

    from sabench.geometry.common_view import grid_of_box

    low, high = np.array(box[::2]), np.array(box[1::2])
    return grid_of_box(low, high, float(np.cbrt(np.prod(high - low) / 1000.0)))
