"""Function calls in a child process.

A crash, a hang or a leak there does not affect this one. The child may be confined, too: then it
sees only given files, no other process and no network, and what it answers is data, never code.
Files of others are read in a child with limits of memory and CPU time, because libraries that read
them may crash, loop for ever or fill the memory.
"""

import contextlib
import functools
import json
import math
import multiprocessing
import multiprocessing.util
import os
import sys
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import Any

from sabench.utils import errors
from sabench.utils.errors import InputError, UncheckedError
from sabench.utils.kernel_folder import kernel_folder
from sabench.utils.processes.confinement import VisiblePaths, confine, die_with_parent
from sabench.utils.processes.program import describe_end, kill_tree, overdue
from sabench.utils.processes.python import ignored_interrupts

_PRELOADED: list[str] = []
_LAST_PRELOADED = "sabench.utils.processes.server"
_KEPT = (  # variables that a confined process gets; and those that begin so
    ("PATH", "LANG", "TZ", "TERM", "COLUMNS", "NO_COLOR", "FORCE_COLOR", "CUDA_VISIBLE_DEVICES"),
    ("LC_", "LD_", "NUMBA_", "OMP_", "OPENBLAS_", "MKL_", "DRJIT_", "MI_", "SABENCH_", "PYTHON"),
)
_CPU_S = 4.0  # seconds of CPU time for the structure of a file
_RATE = 2e7  # bytes of a file for each further second
_MEMORY_MB = 1000.0  # of the child, besides what it shares with its server
_EXPANSION = 50.0  # times a file's size that its values may take in addition
_PATIENCE = 30.0  # seconds for each of CPU time, after which a sleeping child is killed
_OVERDUE = "signal SIGXCPU"


def call_isolated(
    function: Callable[..., Any],
    *arguments: Any,
    doing: str,
    time_s: float | None = None,
    view: VisiblePaths | None = None,
) -> Any:
    """Call a module's function in a child process and return its result.

    Arguments must be picklable, the result one that JSON holds.

    Parameters
    ----------
    doing : subject of errors, as "solver msa".
    time_s : time limit, after which the process is killed; None: no limit.
    view : confines the child to these files.

    Raises InputError: the function raises one, an OSError or a MemoryError; the process dies, or
    exceeds its time.
    """
    context = _context()
    receiver, sender = context.Pipe(duplex=False)
    environment = dict(os.environ) if view is None else _choose_environment(view)
    child = context.Process(target=_call, args=(sender, environment, view, function, arguments))
    with ignored_interrupts(), _without_script():
        child.start()
    sender.close()
    try:
        if not receiver.poll(time_s):
            assert time_s is not None
            raise InputError(f"{doing}: {overdue(time_s)}")
        try:
            answer: dict[str, Any] = json.loads(receiver.recv_bytes())
        except EOFError:  # it died before it could answer
            child.join()
            end = describe_end(child.exitcode)
            raise InputError(f"{doing}: its process ended with {end}") from None
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
    """Hide the user's script, and a `csv.py` beside it, which the child would run."""
    script, safe = sys.modules["__main__"], os.environ.get("PYTHONSAFEPATH", "")
    sys.modules["__main__"] = ModuleType("__main__")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        os.environ["PYTHONSAFEPATH"] = safe  # an empty one is none


def _choose_environment(view: VisiblePaths) -> dict[str, str]:
    names, beginnings = _KEPT
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name in names or name.startswith(beginnings)
    }
    kernels = str(kernel_folder().parent)  # which is not found from another HOME
    return inherited | {"HOME": view.home, "TMPDIR": "/tmp", "NUMBA_CACHE_DIR": kernels}


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
    view: VisiblePaths | None,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
) -> None:
    os.environ.clear()  # they are those of the server when it started
    os.environ.update(environment)
    sys.argv = sys.argv[:1]
    # Close what leads to other processes. One file tells the server that its clients live: held
    # here, it would outlive a killed parent.
    os.closerange(3, sender.fileno())
    os.closerange(sender.fileno() + 1, multiprocessing.util.MAXFD)
    resource_tracker._resource_tracker._fd = None  # type: ignore[attr-defined] # one of its own
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


def read_isolated(
    read: Callable[..., None], path: Path, *arguments: Any, size_bytes: int | None = None
) -> None:
    """Call `read(path, *arguments)`, a module's function, in a limited child process.

    The limit of time is CPU time of the reading alone: the start of the process and other programs
    on the machine do not count.

    A worker that may have no child processes (Dask's) calls it directly: the process that hands out
    the tasks has read the same file before.

    Parameters
    ----------
    size_bytes : size of all that it reads; None: that of the file.

    Raises InputError: the function raises an exception, the process crashes, or takes more memory
    than the file's size justifies. Raises UncheckedError: the reading took more than its CPU time,
    so the file may be intact.
    """
    if multiprocessing.current_process().daemon:
        read(path, *arguments)
        return
    size = path.stat().st_size if size_bytes is None else size_bytes
    cpu_s = math.ceil(_CPU_S + size / _RATE)
    memory_mb = _MEMORY_MB + _EXPANSION * size / 1e6
    limits, time_s = (memory_mb, cpu_s), _PATIENCE * max(cpu_s, 1)
    doing = f"{path}: reading it"
    try:
        call_isolated(_read, read, limits, path, arguments, doing=doing, time_s=time_s)
    except InputError as error:
        spent, late = str(error).endswith(_OVERDUE), str(error).endswith(overdue(time_s))
        if spent or late:
            limit = f"{cpu_s} s of CPU time" if spent else f"{time_s:g} s"
            raise UncheckedError(
                f"{path}: could not be checked, because reading it takes more than {limit}"
            ) from error
        raise


def _read(
    read: Callable[..., None], limits: tuple[float, float], path: Path, arguments: tuple[Any, ...]
) -> None:
    _limit_self(*limits)
    nowhere = os.open(os.devnull, os.O_WRONLY)  # for what libraries print about damaged files
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os.close(nowhere)
    try:
        read(path, *arguments)
    except InputError:
        raise
    except MemoryError as error:
        sentence = f"{path}: expected a file that can be read with {limits[0]:.0f} MB of memory"
        raise InputError(sentence) from error
    except Exception as error:  # libraries raise what their parsers raise
        name = type(error).__name__
        raise InputError(f"{path}: expected an intact file, got {name}: {error}") from error


def _limit_self(memory_mb: float, cpu_s: float) -> None:
    """Limit the memory and the CPU time that this process may still take.

    A request for more memory fails; more CPU time ends the process by SIGXCPU. Only for child
    processes: the limits stay. Without effect where the system has no such limits (Windows), and
    without a limit of memory where the system does not report how much is in use (macOS).
    """
    try:
        import resource
    except ImportError:
        return
    limits = {resource.RLIMIT_CORE: 0}
    limits[resource.RLIMIT_CPU] = math.ceil(time.process_time() + cpu_s)
    sizes = Path("/proc/self/statm")
    if sizes.exists():
        used = int(sizes.read_text().split()[0]) * resource.getpagesize()
        limits[resource.RLIMIT_AS] = int(used + 1e6 * memory_mb)
    for kind, value in limits.items():
        soft, hard = resource.getrlimit(kind)
        bounds = [bound for bound in (value, soft, hard) if bound != resource.RLIM_INFINITY]
        resource.setrlimit(kind, (min(bounds), hard))
