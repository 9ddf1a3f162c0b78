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


def announce_compiling() -> None:
    """Announce kernels that take long to compile, on standard error."""
    from sabench.utils.progress import announce_compiling as announce  # it takes long to load

    announce()


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


STEP = "Step of preprocessing, as in sliding_minimum,window_px=9; repeatable."


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


def option(metavar: str | None, text: str, *flags: str, **more: Any) -> Any:
    """Declare an option by the word for its value and its help."""
    return typer.Option(*flags, metavar=metavar, help=text, **more)


def argument(metavar: str, text: str, **more: Any) -> Any:
    """Declare an argument by its word and its help."""
    if metavar in _KIND_OF:
        more["callback"] = _check_kind
    return typer.Argument(metavar=metavar, help=text, **more)


_KIND_OF = {word.replace(" ", "").upper(): word for word in ("data set", "result", *KINDS[1:])}


def _check_kind(context: typer.Context, param: typer.CallbackParam, value: Any) -> Any:
    """Refuse the name of another kind of thing: arguments may be in another order."""
    wanted = _KIND_OF[str(param.metavar)]
    kinds = _kinds_of(str(value)) if value is not None else []
    if kinds and wanted not in kinds:
        pieces = context.command_path, *context.command.collect_usage_pieces(context)
        usage = " ".join(piece.strip("{}") for piece in pieces)
        raise InputError(
            f"{param.metavar}: expected a {wanted}, got {value}, the name of a {kinds[0]}; "
            f"usage: {usage}"
        )
    return value


def _kinds_of(word: str) -> list[str]:
    """Find what a word names: a data set, a result, or parts of sabench."""
    from sabench.dataset.schema import MANIFEST  # they take long to load
    from sabench.utils.files import is_file

    path = Path(word)
    named = {
        "data set": is_file(path / MANIFEST),
        "result": path.suffix == ".h5" and is_file(path),
        "solver": word in plugins.names("solvers"),
        "scene": word in plugins.list_scenes(),
        "suite": word in plugins.list_suites(),
    }
    return [kind for kind, fits in named.items() if fits]


def output_option(metavar: str, text: str) -> Any:
    """Declare the option -o for the file or folder to create."""
    return option(metavar, text, "-o", "--output")


DataSet = Annotated[Path, argument("DATASET", "A data set folder.")]
SceneName = Annotated[
    str, argument("SCENE", "A scene file or a bundled scene.", autocompletion=complete_scene)
]
SuiteName = Annotated[
    str,
    argument(
        "SUITE",
        "A suite file, or the name of a bundled suite.",
        autocompletion=complete(plugins.list_suites),
    ),
]
ParameterPairs = Annotated[
    list[str] | None, option("NAME=VALUE", "Set a parameter; repeatable.", "-p", "--parameter")
]
TimeLimit = Annotated[float | None, option("SECONDS", "Time limit of a program. [default: 3600]")]
MemoryLimit = Annotated[
    float | None,
    option("MB", "Memory limit of all processes of a program. [default: 90 % of the free memory]"),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing output.")]
Cards = Annotated[list[Path] | None, option("FILE", "Solver card; repeatable.", "--card")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON value.")]
Leaderboard = Annotated[Path, option("FOLDER", "Folder of the records and the page.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print rough time, memory and disk; stop.")]
Jobs = Annotated[int, option("N", "Number of processes that generate data.", min=1)]
