"""Options that several commands share, and completion of their values."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sabench import plugins
from sabench.utils.errors import InputError

if TYPE_CHECKING:
    from sabench.images.preprocessing import Step

KINDS = ("generator", "solver", "scene", "suite")


def say(text: str) -> None:
    """Print a line to standard output."""
    typer.echo(text)


def say_json(value: Any) -> None:
    """Print one JSON value; numbers that are not finite are refused."""
    say(json.dumps(value, allow_nan=False))


def parse_parameters(pairs: list[str] | None) -> dict[str, Any]:
    """Read name=value pairs; a value is TOML if it parses as TOML, else a string."""
    values: dict[str, Any] = {}
    for pair in pairs or []:
        name, sign, text = pair.partition("=")
        if not sign or not name:
            raise InputError(f"-p {pair}: expected name=value")
        try:
            values[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = text
    return values


def parse_steps(words: list[str]) -> tuple[Step, ...]:
    """Read steps of preprocessing: names and key=value pairs, joined by commas."""
    from sabench.images.preprocessing import read_steps

    tables = []
    for word in words:
        name, *keys = word.split(",")
        tables.append({"step": name, **parse_parameters(keys)})
    return read_steps(tables, "--step")


def complete(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Make the completion of an option by names that start as the word does."""

    def complete_word(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete_word


complete_solver = complete(plugins.list_solvers)
complete_scene = complete(plugins.list_scenes)
complete_task = complete(plugins.list_tasks)

DataSet = Annotated[Path, typer.Argument(metavar="DATASET", help="A data set folder.")]
SceneName = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="A scene file, or the name of a bundled scene.",
        autocompletion=complete_scene,
    ),
]
SuiteName = Annotated[
    str,
    typer.Argument(
        metavar="SUITE",
        help="A suite file, or the name of a bundled suite.",
        autocompletion=complete(plugins.list_suites),
    ),
]
ParameterPairs = Annotated[
    list[str] | None,
    typer.Option("-p", "--parameter", metavar="NAME=VALUE", help="Set a parameter; repeatable."),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS", help="Time limit of a program. [default: 3600]", show_default=False
    ),
]
MemoryLimit = Annotated[
    float | None,
    typer.Option(
        metavar="MB",
        help="Memory limit of all processes of a program. [default: 90 % of the free memory]",
        show_default=False,
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output.")]
Cards = Annotated[
    list[Path] | None,
    typer.Option("--card", metavar="FILE", help="Solver card of the results; repeatable."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON value.")]
Leaderboard = Annotated[
    Path, typer.Option(metavar="FOLDER", help="Folder of the records and the page.")
]
Jobs = Annotated[
    int, typer.Option(min=1, metavar="N", help="Number of processes that generate data.")
]
