"""External programs and Python in child processes."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from sabench.utils.errors import InputError
from sabench.utils.processes.program import (
    ProgramLimits,
    check_exit_code,
    describe_end,
    kill_tree,
    last_line,
    limits_of,
    run_limited,
)
from sabench.utils.processes.python import Reply, Servers, run_code, start_python
from tests.helpers.refusals import refused


def program(folder: Path, body: str, name: str = "program") -> list[str]:
    path = folder.parent / name
    path.write_text(f"#!{sys.executable} -I\nimport os, signal, subprocess, sys, time\n{body}\n")
    path.chmod(0o755)
    return [str(path)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "work"
    made.mkdir()
    return made


def test_time_and_memory_are_measured_from_outside_with_children(folder: Path) -> None:
    body = "held = bytearray(150_000_000); import time; time.sleep(0.5)"
    child = f"child = subprocess.Popen([sys.executable, '-c', {body!r}])\nchild.wait()"
    for each in (body, child):
        cost = run_limited(program(folder, each), folder, ProgramLimits(), "p")
        assert cost.seconds >= 0.5
        assert 150.0 < cost.peak_mb < 400.0


def test_it_gets_a_clean_environment(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "1")
    body = (
        "print(sorted(os.environ), os.environ['HOME'] == os.getcwd(), sys.stdin.read() == '', "
        "os.getsid(0) == os.getpid(), file=open('seen', 'w'))"
    )
    run_limited(program(folder, body), folder, ProgramLimits(), "p")
    names, *facts = (folder / "seen").read_text().rsplit(maxsplit=3)
    assert "'PATH'" in names
    assert "SECRET'" not in names
    assert facts == ["True", "True", "True"]


HOLD = "held = bytearray(300_000_000)\ntime.sleep(60)"
ONE_FILE = "signal.signal(signal.SIGXFSZ, signal.SIG_DFL)\nfile = open('big', 'wb')\n"
ONE_FILE += "while True: file.write(bytes(100_000))"
FILES = "for i in range(40): open(str(i), 'wb').write(bytes(500_000))\ntime.sleep(60)"
CONTROLS = r"sys.stderr.write('\x1b[2J\x07evil ' + 'y' * 100_000)" + "\nsys.exit(1)"
ENDLESS = "while True: print('x' * 1000, file=sys.stderr)"


@pytest.mark.slow_but_first
@pytest.mark.parametrize(
    ("body", "limits", "key"),
    [
        ("time.sleep(60)", ProgramLimits(time_s=0.4), "0.4 s"),
        (HOLD, ProgramLimits(memory_mb=100.0), "100 MB"),
        ("sys.exit('no such camera')", ProgramLimits(), "no such camera"),
        ("print('only this')\nsys.exit(3)", ProgramLimits(), "only this"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", ProgramLimits(), "SIGSEGV"),
        (ONE_FILE, ProgramLimits(output_mb=1.0), "1 MB"),
        (FILES, ProgramLimits(output_mb=1.0), "1 MB"),
        (ENDLESS, ProgramLimits(time_s=0.5), "xxx"),
        (CONTROLS, ProgramLimits(), "yyy"),
    ],
)
def test_breaches_end_in_one_sentence(
    folder: Path, body: str, limits: ProgramLimits, key: str
) -> None:
    with refused(key) as caught:
        run_limited(program(folder, body), folder, limits, "p")
    assert str(caught.value).startswith("program p: ")
    assert str(caught.value).isprintable()


def is_alive(pid: int) -> bool:
    return psutil.pid_exists(pid) and bool(psutil.Process(pid).status() != "zombie")


def alive(folder: Path) -> list[int]:
    return [pid for file in folder.glob("[0-9]*") if is_alive(pid := int(file.name))]


DAEMON = """
def note(): open(str(os.getpid()), 'w').close()
if os.fork() == 0:
    {escape}
    if os.fork() == 0:
        note()
        time.sleep(60)
    os._exit(0)
while not [name for name in os.listdir() if name.isdigit()]: time.sleep(0.01)
{end}
"""


@pytest.mark.slow_but_first
@pytest.mark.parametrize("escape", ["pass", "os.setsid()"])
@pytest.mark.parametrize("end", ["pass", "sys.exit(1)", "time.sleep(60)"])
def test_nothing_that_it_started_is_left(folder: Path, escape: str, end: str) -> None:
    body = DAEMON.format(escape=escape, end=end)
    if end == "pass":
        run_limited(program(folder, body), folder, ProgramLimits(), "p")
    else:
        with pytest.raises(InputError):
            run_limited(program(folder, body), folder, ProgramLimits(time_s=1.0), "p")
    assert list(folder.glob("[0-9]*"))
    deadline = time.monotonic() + 5.0
    while alive(folder) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert alive(folder) == []


def test_what_cannot_be_started(folder: Path) -> None:
    path = folder.parent / "no_program"
    path.write_text("neither a script nor a binary")
    path.chmod(0o755)
    with refused("p", "Exec format error"):
        run_limited([str(path)], folder, ProgramLimits(), "p")


def test_limits_must_be_positive() -> None:
    assert limits_of(None, None) is None
    assert limits_of(None, 5.0) == ProgramLimits(memory_mb=5.0)
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        with refused():
            limits_of(bad, None)


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


def test_a_request_to_a_dead_server_raises_nothing(servers: Servers) -> None:
    servers.running()
    os.kill(servers.pids[0], signal.SIGKILL)
    time.sleep(0.1)
    servers.request(0, 1)
    assert servers.receive() == Reply(0, end="signal SIGKILL")


def test_half_an_answer_is_none(servers: Servers) -> None:
    servers.running()
    servers.request(1, "half")
    assert servers.receive() == Reply(1, end="signal SIGKILL")


def test_children_ignore_interrupts_and_this_process_does_not() -> None:
    before = signal.getsignal(signal.SIGINT)
    code = "import signal; print(signal.getsignal(signal.SIGINT) == signal.SIG_IGN)"
    assert run_code(code, "it", 60.0) == "True"
    assert signal.getsignal(signal.SIGINT) == before


def test_threads_and_modules_of_children() -> None:
    code = "import os, sabench; print(os.environ['NUMBA_NUM_THREADS'])"
    assert start_python(["-c", code], threads=3).communicate()[0].split() == [b"3"]


def test_code_that_fails_or_hangs_is_a_sentence() -> None:
    with refused("it", "1", "no"):
        run_code("raise SystemExit('no')", "it", 60.0)
    with refused("it", "0.5 s"):
        run_code("import time; time.sleep(60)", "it", 0.5)


def test_ends_have_names() -> None:
    names = [describe_end(code) for code in (0, 3, -6, -1000)]
    assert names == ["exit code 0", "exit code 3", "signal SIGABRT", "signal 1000"]
    check_exit_code("it", 0, "")
    with refused("it", "2"):
        check_exit_code("it", 2, "")


def test_the_last_line_is_printable() -> None:
    assert last_line(b"one\n  two \x1b[2J\n \n").startswith("two")
    assert last_line(b"two \x1b[2J").isprintable()
    assert last_line(b"") == ""


def test_a_tree_is_killed_whole() -> None:
    start, wait = "subprocess.Popen([sys.executable, '-c', wait])", "import time; time.sleep(60)"
    code = f"import subprocess, sys; wait = {wait!r}; print({start}.pid, flush=True); exec(wait)"
    process: Any = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    with process.stdout:
        below = int(process.stdout.readline())
    kill_tree(process.pid)
    assert process.wait() == -signal.SIGKILL
    end = time.monotonic() + 5.0
    while is_alive(below):
        assert time.monotonic() < end
        time.sleep(0.02)
