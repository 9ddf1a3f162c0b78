"""Functions called in processes of their own: a crash, a hang or a leak there is not one here."""

from __future__ import annotations

import functools
import multiprocessing
import multiprocessing.connection
import signal
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

from sabench.utils.errors import InputError


def apart(
    function: Callable[..., Any], *arguments: Any, doing: str, time_s: float | None = None
) -> Any:
    """What a module's function returns for picklable arguments, called in a process of its own.

    Parameters
    ----------
    doing : named in errors, as "solver msa".
    time_s : after which the process is ended; None: never.

    Raises
    ------
    InputError
        What the function raises as such, or as an OSError or MemoryError; a process that dies or
        takes too long.
    """
    context = _context()
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_call, args=(sender, function, arguments))
    _start_deaf(child)
    sender.close()
    try:
        fault, value = _answer(receiver, child, doing, time_s)
    except BaseException:
        child.kill()
        raise
    finally:
        child.join()
        receiver.close()
    if fault is not None:
        raise fault
    return value


def _answer(
    receiver: multiprocessing.connection.Connection,
    child: BaseProcess,
    doing: str,
    time_s: float | None,
) -> tuple[InputError | None, Any]:
    if not receiver.poll(time_s):
        raise InputError(f"{doing}: expected an end within {time_s:g} s, but it was still running")
    try:
        answer: tuple[InputError | None, Any] = receiver.recv()
    except EOFError:  # it died without a word
        child.join()
        return InputError(f"{doing}: its process ended with exit code {child.exitcode}"), None
    return answer


@functools.cache
def _context() -> Any:
    """Processes forked from one that has loaded what solvers need and nothing else, which saves each a second; spawned where there is no fork."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        [
            "sabench.tasks.solve_and_score",
            "sabench.evaluation.gates.reference_kernel",
            "sabench.algorithms.refocus",
            "sabench.algorithms.tomography.problem",
        ]
    )
    return context


def _start_deaf(child: BaseProcess) -> None:
    """Start a process that does not hear Ctrl-C, which a terminal sends to all: the parent hears it and ends the child."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        child.start()
    finally:
        signal.signal(signal.SIGINT, before)


def _call(
    sender: multiprocessing.connection.Connection,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
) -> None:
    try:
        value = function(*arguments)
    except (InputError, OSError, MemoryError) as error:
        sender.send(
            (
                error
                if isinstance(error, InputError)
                else InputError(f"{error}" or type(error).__name__),
                None,
            )
        )
    else:
        sender.send((None, value))
