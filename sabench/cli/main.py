"""The command `sabench`: its subcommands, exit codes and error messages."""

import contextlib
import functools
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from sabench.cli import (
    compare,
    describe,
    importing,
    maintain,
    make_data,
    own_recordings,
    solve_and_judge,
)
from sabench.cli.options import say
from sabench.utils.errors import InputError
from sabench.utils.installed import lacking
from sabench.utils.version import __version__


class _Tidy:
    """Command that shows nothing for the value of a flag, which has none."""

    def get_params(self, ctx: Any) -> list[Any]:
        """List the arguments and options."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params


class Command(_Tidy, TyperCommand):
    """A subcommand."""


class Group(_Tidy, TyperGroup):
    """The command itself."""


# fmt: off
_PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "Make data": (make_data.plan, make_data.generate, make_data.verify, make_data.pack),
    "Solve and judge": (
        solve_and_judge.solve, solve_and_judge.score, solve_and_judge.refocus,
        solve_and_judge.quality, solve_and_judge.view, importing.export, importing.import_result,
    ),
    "Compare": (
        compare.run, compare.check, compare.submit, compare.board, compare.reproduce,
        compare.challenge, compare.participate,
    ),
    "Your own recordings": (
        own_recordings.calibrate, importing.import_recording, own_recordings.preprocess,
        own_recordings.compare_statistics,
    ),
    "Maintain": (
        maintain.list_all, describe.info, maintain.schema, maintain.new, solve_and_judge.conform,
        maintain.warmup, maintain.doctor,
    ),
}
# fmt: on
_NAMES = {"list_all": "list", "import_recording": "import"}

app = typer.Typer(cls=Group)
for _panel, _commands in _PANELS.items():
    for _command in _commands:
        _word = _command.__name__
        _name = _NAMES.get(_word, _word.replace("_", "-"))
        app.command(_name, cls=Command, rich_help_panel=_panel)(_command)

_INTERRUPTED = "interrupted: finished work is kept, nothing is left half-written"
_AGAIN_S = 0.05  # until a Ctrl-C is repeated


@app.callback(invoke_without_command=True)
def top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Synthetic data with known truth for volumetric velocimetry, and benchmarks."""
    if version:
        say(f"sabench {__version__}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        say(context.get_help())


def main() -> NoReturn:
    """Run the command.

    Exit code 0: done; 1: a check failed; 2: wrong input, a fault of the disk, or an interrupt.
    """
    sys.unraisablehook = functools.partial(_interrupt_again, sys.unraisablehook)
    try:
        code = app(standalone_mode=False)
    except InputError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        _fail(_INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except OSError as error:
        _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except ModuleNotFoundError as error:
        fault = lacking(error)
        if fault is None:
            raise
        _fail(fault)
    except MemoryError as error:
        _fail(f"out of memory: {error}")
    except Exception as error:
        if not hasattr(error, "exit_code"):
            raise
        if type(error).__name__ == "Abort":
            _fail(_INTERRUPTED)
        _fail(error.format_message())  # type: ignore[attr-defined]
    if code == 130:  # the command-line library reports Ctrl-C so
        _fail(_INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


def _interrupt_again(otherwise: Callable[[Any], None], fault: Any) -> None:
    """Repeat a Ctrl-C that came within a destructor, which Python does not pass on."""
    if not isinstance(fault.exc_value, KeyboardInterrupt):
        otherwise(fault)
        return
    again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
    again.daemon = True
    again.start()


def _fail(message: str) -> NoReturn:
    """Print a message to standard error and exit with code 2.

    Further lines of the message are indented.
    """
    lines = [" ".join(line.split()) for line in message.splitlines()]
    with contextlib.suppress(OSError):
        print("sabench: " + "\n  ".join(line for line in lines if line), file=sys.stderr)
    sys.exit(2)
