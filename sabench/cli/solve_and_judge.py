"""Commands on a result or solver: solve, score, conform, refocus, quality, view."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from sabench.cli import options
from sabench.cli.options import AsJson, Overwrite, argument, option, output_option, say, say_json

if TYPE_CHECKING:
    from sabench.algorithms.refocus import Join


def solve(
    solver: Annotated[
        str,
        argument(
            "SOLVER",
            "Name of a solver, or path of a program (see docs/developing/participate.md).",
            autocompletion=options.complete_solver,
        ),
    ],
    dataset: options.DataSet,
    output: Annotated[Path, output_option("FILE", "The result file to create.")],
    parameter: options.ParameterPairs = None,
    time_limit: options.TimeLimit = None,
    memory_limit: options.MemoryLimit = None,
    dry_run: options.DryRun = False,
    overwrite: Overwrite = False,
) -> None:
    """Run a solver on a data set and write its result file."""
    from sabench.apps.costs import announce, cost_of_solve
    from sabench.dataset.verification import probe_dataset
    from sabench.tasks.solve_and_score import solve as run_solver
    from sabench.utils.processes.program import limits_of

    options.announce_compiling()
    probe_dataset(dataset)
    given, limits = options.parse_parameters(parameter), limits_of(time_limit, memory_limit)
    announce(cost_of_solve(solver, dataset, given, exact=dry_run), output, dry_run=dry_run)
    result = run_solver(
        solver, dataset, output, parameters=given, limits=limits, overwrite=overwrite
    )
    memory = f"{result.peak_mb:.0f} MB" if result.peak_mb else "unknown memory"
    say(f"{output}: {result.solver}, {result.seconds:.2f} s per frame, at most {memory}")


def score(
    dataset: options.DataSet,
    result: Annotated[
        str,
        argument(
            "RESULT",
            "A result file; truth or empty for the best and worst possible scores; or a .json of "
            "bubbles detected in camera images (COCO's results).",
        ),
    ],
    task: Annotated[
        str | None,
        option(
            "TASK",
            "Task whose scores truth and empty get, if the data set serves several.",
            autocompletion=options.complete_task,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score a result against the truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.solve_and_score import score as scores_of
    from sabench.utils.number_text import significant

    options.announce_compiling()
    probe_dataset(dataset)
    if result.endswith(".json"):
        from sabench.apps.detections import score_detections

        detected = score_detections(dataset, result)
        if as_json:
            say_json(detected)
        else:
            say("\n".join(f"{key:<18}{significant(value)}" for key, value in detected.items()))
        return
    if result not in ("truth", "empty") and Path(result).is_file():
        probe(Path(result))
    scores = scores_of(dataset, result, task)
    if as_json:
        say_json(scores)
    else:
        say(repr(scores))


def conform(
    solver: Annotated[str, argument("SOLVER", "A solver.", autocompletion=options.complete_solver)],
    parameter: options.ParameterPairs = None,
    as_json: AsJson = False,
) -> None:
    """Test a solver against the laws that every solver obeys.

    The exit code is 1 if it breaks one.
    """
    from dataclasses import asdict

    from sabench.tasks.conformance import check_solver

    options.announce_compiling()
    findings = []
    for finding in check_solver(solver, options.parse_parameters(parameter)):
        findings.append(finding)
        if not as_json:
            say(f"{finding.verdict:<8} {finding.law}{': ' + finding.text if finding.text else ''}")
    if as_json:
        say_json([asdict(finding) for finding in findings])
    if any(finding.verdict == "broken" for finding in findings):
        raise typer.Exit(1)


def refocus(
    dataset: options.DataSet,
    output: Annotated[Path, output_option("FOLDER", "The folder to create.")],
    surface: Annotated[str, option("NAME", "Surface: plane, cylinder or height_map.")] = "plane",
    parameter: Annotated[
        list[str] | None,
        option(
            "NAME=VALUE",
            "Set a parameter of the surface, as in center_mm=[0,0,170], turn_deg=[0,20,0], "
            "radius_mm=40 or file=wall.csv; repeatable.",
            "-p",
            "--parameter",
        ),
    ] = None,
    join: Annotated[
        str,
        option(
            "NAME",
            "How views are joined: additive, multiplicative, dark, minimum, maximum or median.",
        ),
    ] = "additive",
    frame: Annotated[int, option("N", "Frame, from 0.", min=0)] = 0,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Refocus one frame on a plane, a cylinder or a height map."""
    from sabench.apps.surfaces import refocus as make
    from sabench.dataset.verification import probe_dataset

    probe_dataset(dataset)
    info = make(
        dataset,
        output,
        surface,
        options.parse_parameters(parameter),
        join=cast("Join", join),  # `make` checks the word
        frame=frame,
        overwrite=overwrite,
    ).summary
    if as_json:
        say_json(info)
        return
    say(
        f"{output}: {surface} of {info['rows']} x {info['columns']} pixels of "
        f"{info['pixel_mm']:g} mm, {info['seen_percent']:.1f} % seen, by {info['views_mean']:.1f} "
        "cameras on average: image.exr, image.png, points.exr, surface.json"
    )


def quality(
    dataset: options.DataSet,
    result: Annotated[Path, argument("RESULT", "A result file of particles or volumes.")],
    frames: Annotated[int, option("N", "Compare the first N frames with their images.", min=1)] = 1,
    again: Annotated[
        bool,
        typer.Option(
            "--again/--no-again",
            help="Run the solver again without each camera, and with each one scrambled.",
        ),
    ] = True,
    output: Annotated[
        Path | None,
        output_option("FOLDER", "Folder to create, with quality.json and residuals.png."),
    ] = None,
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Judge a result by the images that it came from, without truth."""
    from sabench.dataset.verification import probe, probe_dataset
    from sabench.tasks.quality import quality as judge, write_quality

    options.announce_compiling()
    probe_dataset(dataset)
    if result.is_file():
        probe(result)
    judged = judge(dataset, result, frames=frames, solve_again=again)
    if output is not None:
        write_quality(dataset, judged, output, overwrite=overwrite)
    if as_json:
        record = {"figures": judged.figures, "cameras": judged.cameras, "notes": judged.notes}
        say_json(record)
    else:
        say(repr(judged))


def view(
    what: Annotated[
        str,
        argument(
            "RIG|DATASET|RESULT",
            "A scene file or the name of a bundled scene; cameras.json; a data set; or a "
            "result file next to its data set.",
            autocompletion=options.complete_scene,
        ),
    ],
    result: Annotated[Path | None, argument("RESULT", "A result file of the data set.")] = None,
    output: Annotated[Path, output_option("FILE", "The page to create.")] = Path("view.html"),
    as_json: AsJson = False,
    overwrite: Overwrite = False,
) -> None:
    """Show a rig, a data set or a result in space, as one page for any browser.

    The page shows cameras and their light paths, the wall, the light, particles that were found and
    missed, ghosts, trajectories, refocused planes and every camera's image. It needs no network.
    """
    from sabench.apps.viewer.view import view as make
    from sabench.utils.files import refuse_existing

    options.announce_compiling()
    refuse_existing(output, overwrite=overwrite)
    page = make(what, result)
    page.save(output, overwrite=overwrite)
    if as_json:
        say_json({"page": str(output), **page.summary, "notes": page.notes})
        return
    shown = page.summary
    say(
        f"{output}: {shown['cameras']} camera(s), {shown['frames']} frame(s), {shown['particles']} "
        f"particles, {shown['bubbles']} bubbles, {shown['bytes'] / 1e6:.1f} MB"
    )
    for note in page.notes:
        say(f"note: {note}")
