"""Commands on a result or solver: solve, score, conform, refocus, quality, view."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from sabench.cli import tables
from sabench.cli.options import (
    AsJson,
    DataSet,
    MemoryLimit,
    Overwrite,
    ParameterPairs,
    TimeLimit,
    complete_scene,
    complete_solver,
    complete_task,
    parse_parameters,
    say,
    say_json,
)

if TYPE_CHECKING:
    pass
    from sabench.algorithms.refocus import Join
    from sabench.tasks.quality import Quality


def solve(
    solver: Annotated[
        str,
        typer.Argument(
            metavar="SOLVER",
            help="Name of a solver, or path of a program (see docs/developing/participate.md).",
            autocompletion=complete_solver,
        ),
    ],
    dataset: DataSet,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The result file to create.")
    ],
    parameter: ParameterPairs = None,
    time_limit: TimeLimit = None,
    memory_limit: MemoryLimit = None,
    overwrite: Overwrite = False,
) -> None:
    """Run a solver on a data set and write its result file."""
    from sabench.dataset.verification import probe_dataset
    from sabench.tasks.solve_and_score import solve as run_solver
    from sabench.utils.processes.program import limits_of
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    result = run_solver(
        solver,
        dataset,
        output,
        parameters=parse_parameters(parameter),
        limits=limits_of(time_limit, memory_limit),
        overwrite=overwrite,
    )
    memory = f"{result.peak_mb:.0f} MB" if result.peak_mb else "unknown memory"
    say(f"{output}: {result.solver}, {result.seconds:.2f} s per frame, at most {memory}")


def score(
    dataset: DataSet,
    result: Annotated[
        str,
        typer.Argument(
            metavar="RESULT",
            help="A result file, or truth or empty for the best and worst possible scores.",
        ),
    ],
    task: Annotated[
        str | None,
        typer.Option(
            metavar="TASK",
            help="Task whose scores truth and empty get, if the data set serves several.",
            autocompletion=complete_task,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a result against the truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.solve_and_score import score as scores_of
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    if result not in ("truth", "empty") and Path(result).is_file():
        probe(Path(result))
    scores = scores_of(dataset, result, task)
    if as_json:
        say_json(scores)
    else:
        _show_scores(scores)


def _show_scores(scores: dict[str, Any]) -> None:
    from sabench import tasks

    columns = tasks.of(scores["task"]).columns
    figures = [tables.format_number(scores[column.key], column.decimals) for column in columns]
    headings = ["data set", "solver", *(column.key for column in columns)]
    tables.show(headings, [[scores["dataset"][:12], scores["solver"], *figures]])


def conform(
    solver: Annotated[
        str,
        typer.Argument(metavar="SOLVER", help="Name of a solver.", autocompletion=complete_solver),
    ],
    parameter: ParameterPairs = None,
    as_json: AsJson = False,
) -> None:
    """Test a solver against the laws that every solver obeys.

    The exit code is 1 if it breaks one.
    """
    from dataclasses import asdict

    from sabench.tasks.conformance import check_solver
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    findings = []
    for finding in check_solver(solver, parse_parameters(parameter)):
        findings.append(finding)
        if not as_json:
            say(f"{finding.verdict:<8} {finding.law}{': ' + finding.text if finding.text else ''}")
    if as_json:
        say_json([asdict(finding) for finding in findings])
    if any(finding.verdict == "broken" for finding in findings):
        raise typer.Exit(1)


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
    from sabench.apps.surfaces import refocus as make
    from sabench.dataset.verification import probe_dataset

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


def quality(
    dataset: DataSet,
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="A result file of particles or volumes.")
    ],
    frames: Annotated[
        int, typer.Option(min=1, metavar="N", help="Compare the first N frames with their images.")
    ] = 1,
    again: Annotated[
        bool,
        typer.Option(
            "--again/--no-again",
            help="Run the solver again without each camera, and with each one scrambled.",
        ),
    ] = True,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FOLDER",
            help="Folder to create, with quality.json and residuals.png.",
        ),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Judge a result by the images that it came from, without truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.quality import quality as judge, write_quality
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    probe_dataset(dataset)
    if result.is_file():
        probe(result)
    judged = judge(dataset, result, frames=frames, solve_again=again)
    if output is not None:
        write_quality(dataset, judged, output, overwrite=overwrite)
    if as_json:
        say_json({"figures": judged.figures, "cameras": judged.cameras, "notes": judged.notes})
    else:
        _show(judged)


def _show(judged: Quality) -> None:
    from sabench.tasks.quality_figures import FIGURES

    known = {key: one for key, one in FIGURES.items() if judged.figures[key] is not None}
    rows = [
        (key, tables.format_number(judged.figures[key], one.decimals), one.meaning)
        for key, one in known.items()
    ]
    tables.show(("figure", "value", "meaning"), rows)
    of_cameras = [key for key in known if any(key in one for one in judged.cameras.values())]
    lines = [
        (name, *(tables.format_number(one.get(key), known[key].decimals) for key in of_cameras))
        for name, one in judged.cameras.items()
    ]
    tables.show(("camera", *of_cameras), lines)
    for note in judged.notes:
        say(f"note: {note}")


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
    from sabench.apps.viewer.view import view as make
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
