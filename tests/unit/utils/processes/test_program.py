"""Programs within limits: what they see, what they cost, and how they are ended."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import psutil
import pytest

from sabench.utils.errors import InputError
from sabench.utils.processes.program import Limits, limits_of, run_limited


def program(folder: Path, body: str, name: str = "program") -> list[str]:
    """A Python program; what follows its path are its arguments."""
    path = folder.parent / name
    path.write_text(f"#!{sys.executable} -I\nimport os, signal, subprocess, sys, time\n{body}\n")
    path.chmod(0o755)
    return [str(path)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "work"
    made.mkdir()
    return made


def test_time_and_memory_are_measured_from_outside(folder: Path) -> None:
    cost = run_limited(
        program(folder, "held = bytearray(150_000_000)\ntime.sleep(0.5)"), folder, Limits(), "p"
    )
    assert cost.seconds >= 0.5
    assert 150.0 < cost.peak_mb < 400.0


def test_memory_of_children_counts(folder: Path) -> None:
    body = (
        "child = subprocess.Popen([sys.executable, '-c', 'held = bytearray(120_000_000); import "
        "time; time.sleep(0.6)'])\nchild.wait()"
    )
    assert run_limited(program(folder, body), folder, Limits(), "p").peak_mb > 120.0


def test_it_gets_a_clean_environment_and_no_input(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET", "1")
    body = (
        "print(sorted(os.environ), os.environ['HOME'] == os.getcwd(), sys.stdin.read() == '', "
        "os.getsid(0) == os.getpid(), file=open('seen', 'w'))"
    )
    run_limited(program(folder, body), folder, Limits(), "p")
    names, *facts = (folder / "seen").read_text().rsplit(maxsplit=3)
    assert "'PATH'" in names
    assert "SECRET'" not in names
    assert facts == ["True", "True", "True"]


@pytest.mark.parametrize(
    ("body", "limits", "words"),
    [
        ("time.sleep(60)", Limits(time_s=0.4), "within 0.4 s, but it was still running"),
        (
            "held = bytearray(300_000_000)\ntime.sleep(60)",
            Limits(memory_mb=100.0),
            "at most 100 MB of memory",
        ),
        ("sys.exit('no such camera')", Limits(), "exit code 1; its last words: no such camera"),
        ("print('only this')\nsys.exit(3)", Limits(), "exit code 3; its last words: only this"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", Limits(), "signal SIGSEGV"),
        (
            "signal.signal(signal.SIGXFSZ, signal.SIG_DFL)\nfile = open('big', 'wb')\n"
            "while True: file.write(bytes(100_000))",
            Limits(output_mb=1.0),
            "no file larger than 1 MB",
        ),
        (
            "for i in range(40): open(str(i), 'wb').write(bytes(500_000))\ntime.sleep(60)",
            Limits(output_mb=1.0),
            "at most 1 MB of files",
        ),
        (
            "while True: print('x' * 1000, file=sys.stderr)",
            Limits(time_s=0.5),
            "still running; its last words: xxx",
        ),
        (
            r"sys.stderr.write('\x1b[2J\x07evil ' + 'y' * 100_000)" + "\nsys.exit(1)",
            Limits(),
            "its last words: y",
        ),
    ],
)
def test_breaches_end_in_one_sentence(folder: Path, body: str, limits: Limits, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        run_limited(program(folder, body), folder, limits, "p")
    assert str(caught.value).startswith("program p: ")
    assert str(caught.value).isprintable()


def alive(folder: Path) -> list[int]:
    return [
        int(file.name)
        for file in folder.glob("[0-9]*")
        if psutil.pid_exists(int(file.name)) and psutil.Process(int(file.name)).status() != "zombie"
    ]


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


@pytest.mark.parametrize("escape", ["pass", "os.setsid()"])
@pytest.mark.parametrize("end", ["pass", "sys.exit(1)", "time.sleep(60)"])
def test_nothing_that_it_started_is_left(folder: Path, escape: str, end: str) -> None:
    body = DAEMON.format(escape=escape, end=end)
    if end == "pass":
        run_limited(program(folder, body), folder, Limits(), "p")
    else:
        with pytest.raises(InputError):
            run_limited(program(folder, body), folder, Limits(time_s=1.0), "p")
    assert list(folder.glob("[0-9]*"))
    deadline = time.monotonic() + 5.0
    while alive(folder) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert alive(folder) == []


def test_what_cannot_be_started(folder: Path) -> None:
    path = folder.parent / "no_program"
    path.write_text("neither a script nor a binary")
    path.chmod(0o755)
    with pytest.raises(InputError, match=r"it cannot be started: Exec format error"):
        run_limited([str(path)], folder, Limits(), "p")


def test_limits_must_be_positive() -> None:
    assert limits_of(None, None) is None
    assert limits_of(None, 5.0) == Limits(memory_mb=5.0)
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="time limit"):
            limits_of(bad, None)
