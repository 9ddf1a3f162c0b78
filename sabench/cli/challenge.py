"""Commands of challenges on private test sets: challenge and participate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from sabench.cli.options import (
    Cards,
    Jobs,
    MemoryLimit,
    Overwrite,
    ParameterPairs,
    SuiteName,
    TimeLimit,
    complete_solver,
    complete_task,
    parse_parameters,
    say,
)

if TYPE_CHECKING:
    from sabench.api.solvers import TaskName


def challenge(
    suite: SuiteName,
    hidden: Annotated[
        Path,
        typer.Option(
            metavar="FILE", help="The organiser's secret file, from which the seeds come."
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder of the challenge.")
    ],
    task: Annotated[
        str | None,
        typer.Option(
            metavar="TASK",
            help="Task of all results. [default: the only one of the suite]",
            show_default=False,
            autocompletion=complete_task,
        ),
    ] = None,
    codabench: Annotated[
        str | None,
        typer.Option(
            metavar="IMAGE",
            help="Make a bundle for Codabench, too, which scores in this Docker image.",
        ),
    ] = None,
    jobs: Jobs = 1,
) -> None:
    """Make a private test set, and the archive that participants receive.

    If interrupted, run the same command again to resume.
    """
    from sabench.evaluation.challenge.organiser import BUNDLE, PARTICIPANT, make_challenge
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    chosen = cast("TaskName | None", task)  # `make_challenge` checks the word
    made = make_challenge(suite, hidden, output, task=chosen, image=codabench, jobs=jobs)
    count = f"{len(made.data_sets)} data set(s) of the task {made.task}"
    say(f"{output / PARTICIPANT}: images and cameras of {count}, for participants")
    if codabench is not None:
        say(f"{output / BUNDLE}: bundle for the server, with the truth: keep it private")
    say(f"{output / 'private'}: data sets with their truth: keep them private")


def participate(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="CHALLENGE", help="The archive that the organiser sent, or its folder."
        ),
    ],
    solver: Annotated[
        str,
        typer.Argument(
            metavar="SOLVER",
            help="Name of a solver, or path of a program.",
            autocompletion=complete_solver,
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="ARCHIVE", help="The .zip file to create.")
    ],
    card: Cards = None,
    parameters: ParameterPairs = None,
    time_limit: TimeLimit = None,
    memory_limit: MemoryLimit = None,
    results: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder in which results are kept.")
    ] = Path("work/challenge"),
    overwrite: Overwrite = False,
) -> None:
    """Solve all data sets of a challenge and pack the results.

    If interrupted, run the same command again to resume.
    """
    from sabench.evaluation.challenge.participant import participate as solve_all
    from sabench.utils.processes.program import limits_of
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    count = solve_all(
        path,
        solver,
        output,
        results=results,
        cards=card or (),
        parameters=parse_parameters(parameters),
        limits=limits_of(time_limit, memory_limit),
        overwrite=overwrite,
    )
    say(f"{output}: {count} result(s); send it to the organiser")
