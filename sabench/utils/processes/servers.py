"""Child processes that answer each line of JSON with one.

They are replaced when they die.
"""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any

from sabench.utils.processes.ending import describe_end, reap
from sabench.utils.processes.starting import start_python

_Lines = queue.SimpleQueue[tuple[int, bytes]]


@dataclass(frozen=True)
class Reply:
    """Answer of server `number`; `end` says how its process ended, if it did."""

    number: int
    value: Any = None
    end: str | None = None


class Servers:
    """Equal Python processes, numbered in the order of their start.

    Parameters
    ----------
    arguments : of the interpreter. The program reads requests from its standard input, one line
        of JSON each, and answers each with one line of JSON on its standard output.
    count : number of processes.
    threads : of each process.
    """

    def __init__(self, arguments: Sequence[str], count: int, threads: int) -> None:
        self._arguments, self._count, self._threads = arguments, count, threads
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._lines: _Lines = queue.SimpleQueue()
        self._started = 0

    @property
    def pids(self) -> list[int]:
        """Process numbers of the servers."""
        return [process.pid for process in list(self._processes.values())]

    def running(self) -> list[int]:
        """Return the numbers of all servers, after replacing those that have ended."""
        while len(self._processes) < self._count:
            self._start()
        return list(self._processes)

    def request(self, number: int, value: Any) -> None:
        """Send a request; if the server is dead, `receive` reports its end."""
        pipe = self._processes[number].stdin
        assert pipe is not None
        with contextlib.suppress(OSError):
            pipe.write(f"{json.dumps(value)}\n".encode())
            pipe.flush()

    def receive(self) -> Reply:
        """Wait for the next answer or end of a server."""
        number, line = self._lines.get()
        if line:
            return Reply(number, json.loads(line))
        return Reply(number, end=describe_end(reap(self._processes.pop(number))))

    def close(self) -> None:
        """Kill all servers."""
        for process in self._processes.values():
            process.kill()
        for process in self._processes.values():
            reap(process)

    def _start(self) -> None:
        number, self._started = self._started, self._started + 1
        process = start_python(self._arguments, threads=self._threads, stdin=subprocess.PIPE)
        self._processes[number] = process
        listener = (process.stdout, number, self._lines)
        threading.Thread(target=_listen, args=listener, daemon=True).start()


def _listen(pipe: IO[bytes], number: int, lines: _Lines) -> None:
    """Queue each line of a server, and an empty one when it has ended."""
    with contextlib.suppress(OSError, ValueError):
        for line in pipe:
            if line.endswith(b"\n"):  # a killed server may leave half a line
                lines.put((number, line))
    lines.put((number, b""))
