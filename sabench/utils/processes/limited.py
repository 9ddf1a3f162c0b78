"""Programs that are not sabench's own: run within limits of time, memory and output, watched from outside, and ended whole."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.validation import printable

_KEPT = (
    "PATH",
    "LD_LIBRARY_PATH",
    "LANG",
    "LC_ALL",
    "TZ",
    "OMP_NUM_THREADS",
    "CUDA_VISIBLE_DEVICES",
)
_TOKEN = "SABENCH_PROGRAM"  # marks every process that a program starts, wherever it hides
_TAIL = 1 << 14  # bytes of output that are kept
_WAITS = (0.01, 0.25)  # s between two looks, the shortest and the longest
_MEMORY_SHARE = 0.9  # of what is there, where no limit is given

# Run by a fresh interpreter that becomes the program: limits of files and cores, signals as a
# program expects them, death with its parent.
_START = """
import os, resource, signal, sys
for number in (signal.SIGXFSZ, signal.SIGPIPE, signal.SIGINT):
    signal.signal(number, signal.SIG_DFL)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
if sys.platform == "linux":
    import ctypes
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
try:
    os.execv(sys.argv[2], sys.argv[2:])
except OSError as error:
    sys.exit(f"it cannot be started: {error.strerror}")
"""


@dataclass(frozen=True)
class Limits:
    """What a program may use.

    Attributes
    ----------
    time_s : wall time.
    memory_mb : resident memory of all its processes together (10^6 bytes); None: nine tenths of
        what is free when it starts.
    output_mb : size of each file that it writes, and of all that it leaves in its folder.
    """

    time_s: float = 3600.0
    memory_mb: float | None = None
    output_mb: float = 20_000.0

    def __post_init__(self) -> None:
        for name, value in (
            ("time limit", self.time_s),
            ("memory limit", self.memory_mb),
            ("output limit", self.output_mb),
        ):
            if value is not None and not 0.0 < value < float("inf"):
                raise InputError(f"{name}: expected a positive number, got {value:g}")


def limits_of(time_s: float | None, memory_mb: float | None) -> Limits | None:
    """Limits with defaults for what is not given; None where nothing is."""
    if time_s is None and memory_mb is None:
        return None
    return Limits(memory_mb=memory_mb) if time_s is None else Limits(time_s, memory_mb)


@dataclass(frozen=True)
class Cost:
    """What a run took, measured from outside: wall seconds, and the most resident memory of all its processes together (MB)."""

    seconds: float
    peak_mb: float


def run_confined(words: Sequence[str], folder: Path, limits: Limits, name: str) -> Cost:
    """Run a program in `folder` and wait for its end; nothing that it started is left then.

    It gets a session of its own, no standard input and a clean environment with `folder` as its
    home.

    Raises
    ------
    InputError
        It cannot be started, ends with another exit code than 0 or by a signal, or breaks a limit;
        the text holds its last words.
    """
    if os.name != "posix":
        raise InputError(
            f"program {name}: expected Linux or macOS, which can confine a program, got {os.name}"
        )
    token = secrets.token_hex(16)
    start = time.monotonic()
    with _started(words, folder, limits, token) as (process, tails):
        try:
            peak_mb, breach = _watch(process, folder, limits, start)
            seconds = time.monotonic() - start
        finally:
            _end(process, token)
        last = next((text for tail in tails if (text := tail.last_line())), "")
    _refuse_bad_end(name, process.returncode, breach, last, limits.output_mb)
    return Cost(seconds, peak_mb)


def _refuse_bad_end(name: str, code: int, breach: str, last: str, limit_mb: float) -> None:
    words = f"; its last words: {last}" if last else ""
    if breach:
        raise InputError(f"program {name}: {breach}{words}")
    if code == -signal.SIGXFSZ:
        raise InputError(
            f"program {name}: expected no file larger than {limit_mb:.0f} MB, but it went on writing one{words}"
        )
    if code:
        end = f"exit code {code}" if code > 0 else f"signal {_signal_name(-code)}"
        raise InputError(f"program {name}: expected exit code 0, but it ended with {end}{words}")


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)


class _Tail(threading.Thread):
    """Reads a pipe to its end and keeps the last of it."""

    def __init__(self, pipe: IO[bytes]) -> None:
        super().__init__(daemon=True)
        self._pipe, self._kept = pipe, deque[bytes](maxlen=_TAIL // 512)
        self.start()

    def run(self) -> None:
        with contextlib.suppress(ValueError, OSError):  # the pipe may be closed below
            while piece := os.read(self._pipe.fileno(), 512):
                self._kept.append(piece)

    def last_line(self) -> str:
        """The last line that is not empty, fit for printing."""
        self.join(1.0)
        lines = b"".join(self._kept).decode("utf-8", "replace").splitlines()
        return printable(next((line.strip() for line in reversed(lines) if line.strip()), ""), 200)


@contextlib.contextmanager
def _started(
    words: Sequence[str], folder: Path, limits: Limits, token: str
) -> Iterator[tuple[subprocess.Popen[bytes], list[_Tail]]]:
    size = str(int(limits.output_mb * 1e6))
    process = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", _START, size, *words],
        cwd=folder,
        env=_environment(folder, token),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stderr is not None
    assert process.stdout is not None
    tails = [_Tail(process.stderr), _Tail(process.stdout)]
    try:
        yield process, tails
    finally:
        for tail, pipe in zip(tails, (process.stderr, process.stdout), strict=True):
            tail.join(1.0)
            if (
                not tail.is_alive()
            ):  # else something that escaped holds the pipe: closing it would wait for the reader
                pipe.close()


def _environment(folder: Path, token: str) -> Mapping[str, str]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    return kept | {"HOME": str(folder), "TMPDIR": str(folder), _TOKEN: token}


def _watch(
    process: subprocess.Popen[bytes], folder: Path, limits: Limits, start: float
) -> tuple[float, str]:
    """Peak memory (MB) at the program's end or first breach, and what the breach was."""
    allowed, peak_mb, looked = limits.memory_mb or _free_mb(), 0.0, start
    while True:
        now = time.monotonic()
        held = _held_mb(process)
        peak_mb = max(peak_mb, held)
        if process.poll() is not None:
            return peak_mb, ""
        if held > allowed:
            return (
                peak_mb,
                f"expected at most {allowed:.0f} MB of memory, but its processes held {held:.0f} MB",
            )
        if now - start > limits.time_s:
            return peak_mb, f"expected an end within {limits.time_s:g} s, but it was still running"
        if now - looked > 1.0:
            looked = now
            written = _size_mb(folder)
            if written > limits.output_mb:
                return (
                    peak_mb,
                    f"expected at most {limits.output_mb:.0f} MB of files, but it wrote {written:.0f} MB",
                )
        _wait(
            process,
            min(
                max((now - start) / 20.0, _WAITS[0]),
                _WAITS[1],
                max(start + limits.time_s - now, 0.001),
            ),
        )


def _free_mb() -> float:
    there = memory.available_mb()
    return float("inf") if there is None else _MEMORY_SHARE * there


def _wait(process: subprocess.Popen[bytes], seconds: float) -> None:
    """Until the time is over or the program has ended."""
    end = time.monotonic() + seconds
    while process.poll() is None and (left := end - time.monotonic()) > 0.0:
        time.sleep(min(left, 0.01))


def _held_mb(process: subprocess.Popen[bytes]) -> float:
    held = 0
    for member in _family(process):
        with contextlib.suppress(psutil.Error):
            held += member.memory_info().rss
    return held / 1e6


def _family(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """The program's process, all below it, and all of its session."""
    found = {}
    if (
        process.returncode is None
    ):  # once it is known, the system may give the number to another process
        with contextlib.suppress(psutil.Error):
            head = psutil.Process(process.pid)
            found = {one.pid: one for one in (head, *head.children(recursive=True))}
    for other in psutil.pids():
        if other not in found:
            with contextlib.suppress(psutil.Error, OSError):
                if os.getsid(other) == process.pid:
                    found[other] = psutil.Process(other)
    return list(found.values())


def _marked(token: str) -> list[psutil.Process]:
    """Processes that left the session but still carry the token."""
    found = []
    for one in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if one.environ().get(_TOKEN) == token:
                found.append(one)
    return found


def _end(process: subprocess.Popen[bytes], token: str) -> None:
    """Kill whatever is left of a program, again until nothing new has appeared."""
    for _ in range(20):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        left = [
            one
            for one in (*_family(process), *_marked(token))
            if one.pid != os.getpid() and _runs(one)
        ]
        for one in left:
            with contextlib.suppress(psutil.Error):
                one.kill()
        process.poll()
        if not left:
            break
        time.sleep(0.02)
    process.wait()


def _runs(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    return False


def _size_mb(folder: Path) -> float:
    """Bytes on the disk of all files below a folder, in MB; links are not followed."""
    blocks = 0
    for path, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(OSError):
                blocks += os.lstat(os.path.join(path, name)).st_blocks  # noqa: PTH118 (a path object for each of many files is slow)
    return blocks * 512 / 1e6
