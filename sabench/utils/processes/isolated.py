"""Function calls in a child process.

A crash, a hang or a leak there does not affect this one. The child may be confined, too: then it
sees only given files, no other process and no network, and what it answers is data, never code.
"""

from __future__ import annotations

import contextlib
import functools
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any

from sabench.utils import errors
from sabench.utils.errors import InputError
from sabench.utils.processes.confinement import View, confine, die_with_parent
from sabench.utils.processes.ending import describe_end, kill_tree, overdue
from sabench.utils.processes.starting import ignored_interrupts

_PRELOADED: list[str] = []
_LAST_PRELOADED = "sabench.utils.processes.server_end"
_KEPT = (  # variables that a confined process gets; and those that begin so
    ("PATH", "LANG", "TZ", "TERM", "COLUMNS", "NO_COLOR", "FORCE_COLOR", "CUDA_VISIBLE_DEVICES"),
    ("LC_", "LD_", "NUMBA_", "OMP_", "OPENBLAS_", "MKL_", "DRJIT_", "MI_", "SABENCH_", "PYTHON"),
)
_MOST_FILES = 1 << 16  # numbers of open files that are closed


def call_isolated(
    function: Callable[..., Any],
    *arguments: Any,
    doing: str,
    time_s: float | None = None,
    view: View | None = None,
) -> Any:
    """Call a module's function in a child process and return its result.

    Arguments must be picklable, the result one that JSON holds.

    Parameters
    ----------
    doing : subject of errors, as "solver msa".
    time_s : time limit, after which the process is killed; None: no limit.
    view : confines the child to these files.

    Raises
    ------
    InputError
        The function raises one, an OSError or a MemoryError; the process dies, or exceeds its time.
    """
    context = _context()
    receiver, sender = context.Pipe(duplex=False)
    environment = dict(os.environ) if view is None else _choose_environment(view)
    child = context.Process(target=_call, args=(sender, environment, view, function, arguments))
    with ignored_interrupts(), _without_script():
        child.start()
    sender.close()
    try:
        answer = _receive(receiver, child, doing, time_s)
    except BaseException:
        kill_tree(child.pid)
        raise
    finally:
        child.join()
        receiver.close()
    if "fault" in answer:
        kind = errors.DeclinedError if answer.get("declined") else InputError
        raise kind(*answer["fault"])
    return answer["value"]


@contextlib.contextmanager
def _without_script() -> Iterator[None]:
    """Hide the user's script, which the child would run again as it starts."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _choose_environment(view: View) -> dict[str, str]:
    """Choose the variables of a confined process."""
    names, beginnings = _KEPT
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in names or name.startswith(beginnings)
    }
    return kept | {"HOME": view.home, "TMPDIR": "/tmp"}


def _receive(
    receiver: Connection, child: BaseProcess, doing: str, time_s: float | None
) -> dict[str, Any]:
    if not receiver.poll(time_s):
        assert time_s is not None
        raise InputError(f"{doing}: {overdue(time_s)}")
    try:
        answer: dict[str, Any] = json.loads(receiver.recv_bytes())
    except EOFError:  # it died before it could answer
        child.join()
        raise InputError(
            f"{doing}: its process ended with {describe_end(child.exitcode)}"
        ) from None
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
    context.set_forkserver_preload([*_PRELOADED, _LAST_PRELOADED])
    return context


def _call(
    sender: Connection,
    environment: dict[str, str],
    view: View | None,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
) -> None:
    os.environ.clear()  # they are those of the server when it started
    os.environ.update(environment)
    _forget_parent(sender)
    if sys.platform == "linux":
        die_with_parent()
    answer: dict[str, Any] = {}
    try:
        if view is not None:
            confine(view)
        answer["value"] = function(*arguments)
    except InputError as error:
        answer = {"fault": error.arguments, "declined": isinstance(error, errors.DeclinedError)}
    except (OSError, MemoryError) as error:
        answer["fault"] = [f"{error}" or type(error).__name__]
    sender.send_bytes(json.dumps(answer).encode())


def _forget_parent(sender: Connection) -> None:
    """Close what leads to other processes, and forget the parent's command line.

    One file tells the server that its clients live: held here, it would outlive a killed parent.
    """
    sys.argv = sys.argv[:1]
    os.closerange(3, sender.fileno())
    os.closerange(sender.fileno() + 1, _MOST_FILES)
    resource_tracker._resource_tracker._fd = None  # type: ignore[attr-defined] # one of its own
