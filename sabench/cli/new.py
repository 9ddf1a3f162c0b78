"""Command that starts a scene or a repository from one that is bundled: new."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sabench import plugins
from sabench.cli.options import complete_scene, say
from sabench.utils.errors import InputError

KINDS = ("scene", "solver", "suite", "gate")


def complete_template(incomplete: str) -> list[str]:
    """List the templates whose names start so."""
    return [kind for kind in KINDS if kind.startswith(incomplete)]


def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help="scene, solver, suite or gate.", autocompletion=complete_template
        ),
    ],
    path: Annotated[
        Path, typer.Argument(metavar="PATH", help="The folder, or the scene file, to create.")
    ],
    like: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            help="Bundled scene to copy. [default: quick]",
            autocompletion=complete_scene,
            show_default=False,
        ),
    ] = None,
) -> None:
    """Create a copy of a scene to change, or a folder for a solver, suite or gate.

    A folder also has tests and a workflow; its README says what to run first.
    """
    if kind not in KINDS:
        raise InputError(f"KIND: expected one of {', '.join(KINDS)}, got {kind!r}")
    if kind == "scene":
        _copy_scene(like or "quick", path)
    elif like is not None:
        raise InputError(f"--like: expected with a scene, got {like!r} with a {kind}")
    else:
        _copy_template(kind, path)


def _copy_scene(name: str, file: Path) -> None:
    from sabench.scenes.bundled import find
    from sabench.utils.files import complete_or_nothing

    source = find(name, "scenes")
    with complete_or_nothing(file) as partial:
        partial.write_bytes(source.read_bytes())
    say(f"{file}: the scene {source.stem}, to be changed")


def _copy_template(kind: str, folder: Path) -> None:
    import shutil

    from sabench.utils.files import complete_or_nothing

    ignored = shutil.ignore_patterns("__pycache__")
    with complete_or_nothing(folder) as partial:
        shutil.copytree(plugins.bundled_folder("templates") / kind, partial, ignore=ignored)
    say(f"{folder}: template of a {kind}; read README.md")
