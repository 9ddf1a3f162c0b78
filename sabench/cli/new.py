"""Command that starts a repository from a template: new."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sabench import plugins
from sabench.cli.options import say
from sabench.utils.errors import InputError

KINDS = ("solver", "suite", "gate")


def complete_template(incomplete: str) -> list[str]:
    """List the templates whose names start so."""
    return [kind for kind in KINDS if kind.startswith(incomplete)]


def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help="solver, suite or gate.", autocompletion=complete_template
        ),
    ],
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder to create.")],
) -> None:
    """Create a folder with a solver, a suite or a gate, its tests and a workflow.

    Its README says what to run first.
    """
    import shutil

    from sabench.utils.files import complete_or_nothing

    if kind not in KINDS:
        raise InputError(f"KIND: expected one of {', '.join(KINDS)}, got {kind!r}")
    ignored = shutil.ignore_patterns("__pycache__")
    with complete_or_nothing(folder) as partial:
        shutil.copytree(plugins.bundled_folder("templates") / kind, partial, ignore=ignored)
    say(f"{folder}: template of a {kind}; read README.md")
