"""Function calls in a child process.

A crash, a hang or a leak there does not affect this one.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from sabench.utils.errors import InputError
from sabench.utils.processes.ending import describe_end, kill_tree, overdue
from sabench.utils.processes.starting import ignored_interrupts

_PRELOADED: list[str] = []


def call_isolated(
    function: Callable[..., Any], *arguments: Any, doing: str, time_s: float | None = None
) -> Any:
    """Call a module's function in a child process and return its result.

    Arguments must be picklable.

    Parameters
    ----------
    doing : subject of errors, as "solver msa".
    time_s : time limit, after which the process is killed; None: no limit.

    Raises
    ------
    InputError
        The function raises one, an OSError or a MemoryError; the process dies, or exceeds its time.
    """
    context = _context()
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_call, args=(sender, dict(os.environ), function, arguments))
    with ignored_interrupts():
        child.start()
    sender.close()
    try:
        fault, value = _receive(receiver, child, doing, time_s)
    except BaseException:
        kill_tree(child.pid)
        raise
    finally:
        child.join()
        receiver.close()
    if fault is not None:
        raise fault
    return value


def _receive(
    receiver: Connection, child: BaseProcess, doing: str, time_s: float | None
) -> tuple[InputError | None, Any]:
    if not receiver.poll(time_s):
        assert time_s is not None
        raise InputError(f"{doing}: {overdue(time_s)}")
    try:
        answer: tuple[InputError | None, Any] = receiver.recv()
    except EOFError:  # it died before it could answer
        child.join()
        return InputError(f"{doing}: its process ended with {describe_end(child.exitcode)}"), None
    return answer


def preload(*modules: str) -> None:
    """Name modules that child processes need, so that their server loads them once.

    Call it when a module is imported, before the first isolated call.
    """
    _PRELOADED.extend(modules)


@functools.cache
def _context() -> Any:
    """Return the context that forks from a server with preloaded modules.

    The server has loaded the modules that `preload` named, which saves a second. Processes are
    spawned where there is no fork.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    return context


def _call(
    sender: Connection,
    environment: dict[str, str],
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
) -> None:
    os.environ.clear()  # they are those of the server when it started
    os.environ.update(environment)
    try:
        value = function(*arguments)
    except InputError as error:
        sender.send((error, None))
    except (OSError, MemoryError) as error:
        sender.send((InputError(f"{error}" or type(error).__name__), None))
    else:
        sender.send((None, value))
