"""Servers: answers, deaths and replacements.

Also the shared parts of starting and ending.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import psutil
import pytest

from sabench.utils.errors import InputError
from sabench.utils.processes.program import check_end, describe_end, kill_tree, last_line
from sabench.utils.processes.python import Reply, Servers, run_code, start_python

DOUBLE = """
import json, os, sys
for line in sys.stdin:
    value = json.loads(line)
    if value == "half":
        os.write(1, b"[1, ")
        os.kill(os.getpid(), 9)
    print(json.dumps(2 * value), flush=True)
"""


@pytest.fixture
def servers() -> Iterator[Servers]:
    made = Servers(["-c", DOUBLE], 2, threads=1)
    yield made
    made.close()


def test_each_request_has_one_answer(servers: Servers) -> None:
    assert servers.running() == [0, 1]
    servers.request(0, 4)
    servers.request(1, "ab")
    replies = {reply.number: reply for reply in (servers.receive(), servers.receive())}
    assert replies == {0: Reply(0, 8), 1: Reply(1, "abab")}


def test_a_killed_server_is_reported_and_replaced(servers: Servers) -> None:
    servers.running()
    os.kill(servers.pids[0], signal.SIGKILL)
    assert servers.receive() == Reply(0, end="signal SIGKILL")
    assert servers.running() == [1, 2]
    servers.request(2, 1)
    assert servers.receive() == Reply(2, 2)


def test_half_an_answer_is_none(servers: Servers) -> None:
    servers.running()
    servers.request(1, "half")
    assert servers.receive() == Reply(1, end="signal SIGKILL")


def test_a_request_to_a_dead_server_raises_nothing(servers: Servers) -> None:
    servers.running()
    os.kill(servers.pids[0], signal.SIGKILL)
    time.sleep(0.1)
    servers.request(0, 1)
    assert servers.receive() == Reply(0, end="signal SIGKILL")


def test_children_ignore_interrupts_and_this_process_does_not() -> None:
    before = signal.getsignal(signal.SIGINT)
    code = "import signal; print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)"
    assert run_code(code, "it", 60.0) == "True"
    assert signal.getsignal(signal.SIGINT) == before


def test_threads_and_modules_of_children() -> None:
    code = "import os, sabench; print(os.environ['NUMBA_NUM_THREADS'])"
    process = start_python(["-c", code], threads=3)
    assert process.communicate()[0].split() == [b"3"]


def test_code_that_fails_or_hangs_is_a_sentence() -> None:
    with pytest.raises(InputError, match=r"^it: .* exit code 1; its last words: no$"):
        run_code("raise SystemExit('no')", "it", 60.0)
    with pytest.raises(InputError, match=r"it: expected an end within 0.5 s"):
        run_code("import time; time.sleep(60)", "it", 0.5)


def test_ends_have_names() -> None:
    assert [describe_end(code) for code in (0, 3, -6, -1000)] == [
        "exit code 0",
        "exit code 3",
        "signal SIGABRT",
        "signal 1000",
    ]
    check_end("it", 0, "")
    with pytest.raises(InputError, match=r"^it: expected exit code 0, but .* exit code 2$"):
        check_end("it", 2, "")


def test_the_last_line_is_printable() -> None:
    assert last_line(b"one\n  two \x1b[2J\n \n").startswith("two")
    assert last_line(b"two \x1b[2J").isprintable()
    assert last_line(b"") == ""


def test_a_tree_is_killed_whole() -> None:
    code = (
        "import subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "print(child.pid, flush=True)\ntime.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout:
        below = int(process.stdout.readline())
    kill_tree(process.pid)
    assert process.wait() == -signal.SIGKILL
    end = time.monotonic() + 5.0
    while psutil.pid_exists(below) and psutil.Process(below).status() != "zombie":
        assert time.monotonic() < end
        time.sleep(0.02)
