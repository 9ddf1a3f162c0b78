"""The command `sabench warmup`: kernels compiled in advance."""

from __future__ import annotations

from typing import Annotated

import typer

from sabench.cli.options import AsJson, complete_solver, say, say_json


def warmup(
    solvers: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SOLVER",
            help="Names of solvers; by default all.",
            show_default=False,
            autocompletion=complete_solver,
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compile the kernels of solvers now, for images of containers.

    The exit code is 1 if a solver fails.
    """
    from dataclasses import asdict

    from sabench.tasks.warm_up import warm_up
    from sabench.utils.progress import announce_compiling

    announce_compiling()
    warmed = []
    for one in warm_up(solvers or ()):
        warmed.append(one)
        if not as_json:
            say(f"{one.compile_s:6.1f} s {one.solver}{': ' + one.text if one.text else ''}")
    if as_json:
        say_json([asdict(one) for one in warmed])
    if any(one.verdict == "broken" for one in warmed):
        raise typer.Exit(1)
