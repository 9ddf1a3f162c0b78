"""Subcommands that exchange data with other programs: export and import-result."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

from sabench.cli.options import DataSet, Overwrite, argument, option, say

if TYPE_CHECKING:
    from sabench.interop.export import Format
    from sabench.interop.tracks import TrackFormat

_SHOWN = 12  # files that `export` lists


def export(
    dataset: DataSet,
    result: Annotated[Path | None, argument("RESULT", "A result file; by default none.")] = None,
    output: Annotated[
        Path | None,
        option(
            "FOLDER", "The folder to create. [default: the name of the format]", "-o", "--output"
        ),
    ] = None,
    to: Annotated[
        str,
        option(
            "FORMAT",
            "vtk, netcdf, mat or csv: the truth or a result; openptv, myptv, openlpt or "
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
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    say(f"{out}: {', '.join(names[:_SHOWN])}{more}")


def import_result(
    dataset: DataSet,
    found: Annotated[Path, argument("FOUND", "The file or folder that the program wrote.")],
    output: Annotated[Path, option("RESULT", "The result file to create.", "-o", "--output")],
    form: Annotated[
        str,
        option("FORMAT", "openptv, myptv, openlpt, lpt-challenge, netcdf, mat or csv.", "--from"),
    ],
    unit: Annotated[
        str | None,
        option("UNIT", "Unit of lengths, mm, m, um ... [default: as the files say, or mm]"),
    ] = None,
    first: Annotated[
        int | None,
        option("N", "Number of the data set's frame 0 in the files. [default: the smallest]"),
    ] = None,
    name: Annotated[str | None, option("NAME", "Name of the solver. [default: the format]")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Make a result file of particles that another program found.

    `sabench score` and all other commands take it.
    """
    from sabench.interop.tracks import import_result as make

    with notes_shown():
        file = make(
            dataset,
            found,
            output,
            cast("TrackFormat", form),  # `make` checks the word
            unit=unit,
            first=first,
            solver=name,
            overwrite=overwrite,
        )
    tracks = "no" if file.trajectories is None else str(file.trajectories)
    say(f"{file.path}: {file.particles} particles in {file.frames} frames, {tracks} trajectories")


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
