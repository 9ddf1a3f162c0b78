"""The command `sabench`: its subcommands, exit codes and error messages."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Annotated, Any, NoReturn

import typer

from sabench.cli import data, evaluate, exchange, solve
from sabench.cli.challenge import challenge, participate
from sabench.cli.doctor import doctor
from sabench.cli.help_pages import Command, Group
from sabench.cli.importing import import_recording
from sabench.cli.new import new
from sabench.cli.options import say
from sabench.cli.planning import plan
from sabench.cli.preprocess import preprocess
from sabench.cli.quality import quality
from sabench.cli.recordings import compare_statistics
from sabench.cli.refocus import refocus
from sabench.cli.reproduce import reproduce
from sabench.cli.view import view
from sabench.cli.warmup import warmup
from sabench.utils.errors import InputError
from sabench.utils.installed import lacking
from sabench.utils.version import __version__

app = typer.Typer(cls=Group)
app.command("list", cls=Command)(data.list_all)
for _command in (
    data.schema,
    plan,
    data.generate,
    data.verify,
    data.pack,
    compare_statistics,
    preprocess,
    solve.solve,
    solve.score,
    refocus,
    quality,
    view,
    exchange.export,
    exchange.import_result,
    solve.conform,
    solve.calibrate,
    evaluate.run,
    evaluate.check,
    reproduce,
    evaluate.submit,
    challenge,
    participate,
    new,
    evaluate.board,
    doctor,
    warmup,
):
    app.command(_command.__name__.replace("_", "-"), cls=Command)(_command)
app.command("import", cls=Command)(import_recording)

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
        _close_output()
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
        _fail_usage(error)
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


def _close_output() -> None:
    """Send the rest of the output nowhere, because its reader has gone."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail_usage(error: Any) -> NoReturn:
    """End with the message of the command-line library about a wrong command line."""
    if type(error).__name__ == "Abort":
        _fail(_INTERRUPTED)
    _fail(error.format_message())


def _fail(message: str) -> NoReturn:
    """Print a message to standard error and exit with code 2.

    Further lines of the message are indented.
    """
    lines = [" ".join(line.split()) for line in message.splitlines()]
    with contextlib.suppress(OSError):
        print("sabench: " + "\n  ".join(line for line in lines if line), file=sys.stderr)
    sys.exit(2)
