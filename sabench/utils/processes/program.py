"""External programs under time, memory and output limits, and how processes end.

The whole process tree of a program is killed at the end.
"""

import contextlib
import os
import secrets
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from sabench.utils import memory
from sabench.utils.errors import LISTED, InputError
from sabench.utils.processes.confinement import VisiblePaths, start_input, start_words
from sabench.utils.validation import printable

_KEPT: tuple[str, ...] = ("PATH", "LD_LIBRARY_PATH", "LANG", "LC_ALL", "TZ")
_KEPT += ("OMP_NUM_THREADS", "CUDA_VISIBLE_DEVICES")
_TOKEN = "SABENCH_PROGRAM"  # variable that marks every process below a program, wherever it hides
_TAIL = 1 << 14  # bytes of output that are kept
_LOOK_S = 0.25  # longest time between two looks
_OUTPUT_EVERY = 1.0  # time between two looks at the files (s)
_MEMORY_SHARE = 0.9  # of the free memory, where no limit is given


@dataclass(frozen=True)
class ProgramLimits:
    """Resources that a program may use.

    Attributes
    ----------
    time_s : wall time.
    memory_mb : resident memory of all its processes together (10^6 bytes); None: nine tenths of
        the memory that is free when it starts.
    output_mb : size of each file that it writes, and of all files that it leaves in its folder.
    """

    time_s: float = 3600.0
    memory_mb: float | None = None
    output_mb: float = 20_000.0

    def __post_init__(self) -> None:
        """Check that every limit is positive and finite."""
        for name, value in (
            ("time limit", self.time_s),
            ("memory limit", self.memory_mb),
            ("output limit", self.output_mb),
        ):
            if value is not None and not 0.0 < value < float("inf"):
                raise InputError(f"{name}: expected a positive number, got {value:g}")


def limits_of(time_s: float | None, memory_mb: float | None) -> ProgramLimits | None:
    """Return limits with defaults for those that are None; None where both are."""
    if time_s is None and memory_mb is None:
        return None
    return (
        ProgramLimits(memory_mb=memory_mb) if time_s is None else ProgramLimits(time_s, memory_mb)
    )


@dataclass(frozen=True)
class Cost:
    """Cost of a run, measured from outside.

    Attributes
    ----------
    seconds : wall time.
    peak_mb : peak of the resident memory of all its processes together (10^6 bytes).
    """

    seconds: float
    peak_mb: float


def run_limited(
    words: Sequence[str],
    folder: Path,
    limits: ProgramLimits,
    name: str,
    view: VisiblePaths | None = None,
) -> Cost:
    """Run a program in `folder` and wait for its end.

    No process that it started survives it. It gets a session of its own, no standard input and a
    clean environment with `folder` as its home. A view confines it to those files.

    Raises InputError: it cannot be started, ends with another exit code than 0 or by a signal, or
    exceeds a limit; the text quotes the last line of its output.
    """
    if os.name != "posix":
        raise InputError(
            f"program {name}: expected Linux or macOS, which can confine a program, got {os.name}"
        )
    token = secrets.token_hex(16)
    start, command = time.monotonic(), start_words(words, int(limits.output_mb * 1e6))
    with _start(command, start_input(view), folder, token) as (process, tails):
        try:
            peak_mb, breach = _watch(process, folder, limits, start)
            seconds = time.monotonic() - start
        finally:
            _end(process, token)
        last = next((text for tail in tails if (text := tail.last_line())), "")
    if process.returncode == -signal.SIGXFSZ and not breach:
        expected = f"expected no file larger than {limits.output_mb:.0f} MB"
        breach = f"{expected}, but it went on writing one"
    if breach:
        raise InputError(f"program {name}: {breach}{last_words(last)}")
    check_exit_code(f"program {name}", process.returncode, last)
    return Cost(seconds, peak_mb)


class _Tail(threading.Thread):
    """Thread that reads a pipe to its end and keeps the last of it."""

    def __init__(self, pipe: IO[bytes]) -> None:
        super().__init__(daemon=True)
        self._pipe, self._pieces = pipe, deque[bytes](maxlen=_TAIL // 512)
        self.start()

    def run(self) -> None:
        with contextlib.suppress(ValueError, OSError):  # the pipe may be closed below
            while piece := os.read(self._pipe.fileno(), 512):
                self._pieces.append(piece)

    def last_line(self) -> str:
        """Return the last line that is not empty, fit for printing."""
        self.join(1.0)
        return last_line(b"".join(self._pieces))


@contextlib.contextmanager
def _start(
    words: Sequence[str], sent: bytes, folder: Path, token: str
) -> Iterator[tuple[subprocess.Popen[bytes], list[_Tail]]]:
    inherited = {name: os.environ[name] for name in _KEPT if name in os.environ}
    process = subprocess.Popen(
        words,
        cwd=folder,
        env=inherited | {"HOME": str(folder), "TMPDIR": str(folder), _TOKEN: token},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stderr is not None
    assert process.stdout is not None
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
        pipe.write(sent)
    tails = [_Tail(process.stderr), _Tail(process.stdout)]
    try:
        yield process, tails
    finally:
        for tail, pipe in zip(tails, (process.stderr, process.stdout), strict=True):
            tail.join(1.0)
            # else a process that escaped holds the pipe: closing it would wait for the reader
            if not tail.is_alive():
                pipe.close()


def _watch(
    process: subprocess.Popen[bytes], folder: Path, limits: ProgramLimits, start: float
) -> tuple[float, str]:
    """Return peak memory (MB) at a program's end or first breach, and the breach."""
    free_mb = memory.available_mb()
    free_mb = float("inf") if free_mb is None else _MEMORY_SHARE * free_mb
    allowed_mb, peak_mb, looked = limits.memory_mb or free_mb, 0.0, start
    while True:
        now, held = time.monotonic(), _held_mb(process)
        peak_mb = max(peak_mb, held)
        if process.poll() is not None:
            return peak_mb, ""
        if held > allowed_mb:
            breach = f"its processes held {held:.0f} MB"
            return peak_mb, f"expected at most {allowed_mb:.0f} MB of memory, but {breach}"
        if now - start > limits.time_s:
            return peak_mb, overdue(limits.time_s)
        if now - looked > _OUTPUT_EVERY:
            looked, written = now, _size_mb(folder)
            if written > limits.output_mb:
                breach = f"it wrote {written:.0f} MB"
                return peak_mb, f"expected at most {limits.output_mb:.0f} MB of files, but {breach}"
        # the next look: after a twentieth of the time elapsed, not beyond the limit
        end = min(time.monotonic() + min((now - start) / 20.0, _LOOK_S), start + limits.time_s)
        time.sleep(0.01)
        while process.poll() is None and time.monotonic() < end:
            time.sleep(0.01)


def _end(process: subprocess.Popen[bytes], token: str) -> None:
    """Kill all processes of a program, again until no new one has appeared."""
    for _ in range(20):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        left = kill_running((*_family(process), *_find_marked(_TOKEN, token)))
        process.poll()
        if not left:
            break
        time.sleep(0.02)
    process.wait()


def _held_mb(process: subprocess.Popen[bytes]) -> float:
    """Return the resident memory of all processes of a program, in MB (10^6 bytes)."""
    held = 0
    for member in _family(process):
        with contextlib.suppress(psutil.Error):
            held += member.memory_info().rss
    return held / 1e6


def _family(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Return a program's process, all below it, and all of its session."""
    family = {}
    # once its end is known, the system may give the number to another process
    if process.returncode is None:
        with contextlib.suppress(psutil.Error):
            head = psutil.Process(process.pid)
            family = {member.pid: member for member in (head, *head.children(recursive=True))}
    for other in psutil.pids():
        if other not in family:
            with contextlib.suppress(psutil.Error, OSError):
                if os.getsid(other) == process.pid:
                    family[other] = psutil.Process(other)
    return list(family.values())


def _find_marked(variable: str, token: str) -> list[psutil.Process]:
    marked = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get(variable) == token:
                marked.append(process)
    return marked


def _size_mb(folder: Path) -> float:
    """Return the disk space of all files below a folder, in MB; links not followed."""
    blocks = 0
    for path, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(OSError):
                # a path object for each of many files is slow
                blocks += os.lstat(os.path.join(path, name)).st_blocks  # noqa: PTH118
    return blocks * 512 / 1e6


def describe_end(code: int | None) -> str:
    """Return "exit code 3" or "signal SIGABRT"."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"signal {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"


def last_line(output: bytes) -> str:
    """Return the last line that is not empty, fit for printing."""
    lines = output.decode("utf-8", "replace").splitlines()
    return printable(next((line.strip() for line in reversed(lines) if line.strip()), ""), LISTED)


def last_words(line: str) -> str:
    """Return the clause of an error that quotes a process's last line, if any."""
    return f"; its last words: {line}" if line else ""


def check_exit_code(name: str, code: int, line: str) -> None:
    """Raise an InputError with the last line of output unless the exit code is 0."""
    if code:
        end = f"expected exit code 0, but it ended with {describe_end(code)}"
        raise InputError(f"{name}: {end}{last_words(line)}")


def overdue(time_s: float) -> str:
    """Return the clause of an error about a process that exceeds its time limit."""
    return f"expected an end within {time_s:g} s, but it was still running"


@contextlib.contextmanager
def kill_if_left(process: subprocess.Popen[bytes]) -> Iterator[None]:
    """Kill a process and all below it if the block ends first, and close its pipes."""
    try:
        yield
    finally:
        if process.poll() is None:
            kill_tree(process.pid)
        reap(process)


def reap(process: subprocess.Popen[bytes]) -> int:
    """Wait for a process that ends, close its pipes, and return its exit code."""
    code = process.wait()
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    return code


def kill_tree(pid: int) -> None:
    """Kill a process and all below it."""
    with contextlib.suppress(psutil.Error):
        head = psutil.Process(pid)
        kill_running([head, *head.children(recursive=True)])


def kill_running(processes: Iterable[psutil.Process]) -> int:
    """Kill those processes that still run, but not this one; returns their number."""
    left = [process for process in processes if process.pid != os.getpid() and _runs(process)]
    for process in left:
        with contextlib.suppress(psutil.Error):
            process.kill()
    return len(left)


def _runs(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    return False
