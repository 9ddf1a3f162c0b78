"""Commands that are killed: nothing that they started goes on working."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from sabench.dataset.reader import Dataset
from tests.conftest import ROOT

BUSY = "while True: pass"
MARK = "SABENCH_TEST_OF_KILLS"  # variable of all descendants of a command
PROGRAM = f"""#!{sys.executable}
import subprocess, sys
busy = "{BUSY}"
child = subprocess.Popen([sys.executable, "-c", busy])
exec(busy)
"""
PLUGIN = '''"""A solver that does not end."""

from pathlib import Path

from sabench.api import Solver


class Endless(Solver):
    """It computes for ever."""

    name = "endless"
    references = ("nobody",)

    def solve(self, case):
        while True:
            pass
'''
SUITE = """title = "t"
backend = "splat"
solvers = [{ SOLVER }]
[[cases]]
scene = "quick"
name = "few"
set = { "particles.count" = 40, "volume.size_mm" = [7.0, 5.0, 2.0] }
"""
_START_S = 60.0
_BUSY_S = 1.0  # CPU time after which a process counts as working
# all must end after a kill, within 2 s on an idle machine: on a busy one their CPU time counts
_WORK_S, _END_S = 2.0, 20.0


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    program = tmp_path / "endless_program"
    program.write_text(PROGRAM)
    program.chmod(0o755)
    (tmp_path / "mine" / "solvers").mkdir(parents=True)
    (tmp_path / "mine" / "solvers" / "endless.py").write_text(PLUGIN)
    words = 'name = "./endless_program", task = "reconstruction"'
    (tmp_path / "program.toml").write_text(SUITE.replace("SOLVER", words))
    (tmp_path / "plugin.toml").write_text(SUITE.replace("SOLVER", 'name = "endless"'))
    yield tmp_path
    for one in descendants(tmp_path):
        with contextlib.suppress(psutil.Error):
            one.kill()


def descendants(folder: Path) -> list[psutil.Process]:
    """Processes of a command, by a variable that they inherit or by their working folder."""
    found = []
    for one in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if one.pid == os.getpid() or one.status() == psutil.STATUS_ZOMBIE:
                continue
            if one.environ().get(MARK) == str(folder) or str(folder) in " ".join(one.cmdline()):
                found.append(one)
    return found


def below(pid: int) -> set[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        return set(psutil.Process(pid).children(recursive=True))
    return set()


def server_waits(pid: int) -> bool:
    """The server of child processes has started."""
    children = below(pid)
    with contextlib.suppress(psutil.Error):
        return any(cpu_s(one) > 0.3 and one.status() == psutil.STATUS_SLEEPING for one in children)
    return False


def lives(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    return False


def cpu_s(process: psutil.Process) -> float:
    with contextlib.suppress(psutil.Error):
        times = process.cpu_times()
        return float(times.user + times.system)
    return 0.0


def kill_in_the_middle(folder: Path, started: Callable[[int], bool], *words: str) -> list[str]:
    """Start a command, kill it when it works, and list the processes that outlive it."""
    own = {"PYTHONPATH": str(ROOT), "SABENCH_PLUGINS": str(folder / "mine"), MARK: str(folder)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    line = [sys.executable, "-m", "sabench", *words]
    with subprocess.Popen(line, cwd=folder, env=os.environ | own, **quiet) as command:
        end, came = time.monotonic() + _START_S, False
        while not (came := started(command.pid)) and time.monotonic() < end:
            time.sleep(0.05)
        seen = below(command.pid)
        command.kill()
    assert came, "the command never came to its work"
    assert seen, "the command had no child process"

    before = {one: cpu_s(one) for one in {*seen, *descendants(folder)}}
    end = time.monotonic() + _END_S
    while left := [one for one in {*before, *descendants(folder)} if lives(one)]:
        worked = sum(cpu_s(one) - before.get(one, 0.0) for one in left)
        if worked > _WORK_S or time.monotonic() > end:
            break
        time.sleep(0.05)
    return [" ".join(one.cmdline())[:80] for one in left]


def program_works(pid: int) -> bool:
    """The program and its own child compute."""
    with contextlib.suppress(psutil.Error):
        return any(BUSY in one.cmdline() and cpu_s(one) > _BUSY_S for one in below(pid))
    return False


def child_works(pid: int) -> bool:
    """A process below the server of child processes computes."""
    with contextlib.suppress(psutil.Error):
        servers = psutil.Process(pid).children()
        return any(
            cpu_s(one) > _BUSY_S for server in servers for one in server.children(recursive=True)
        )
    return False


@pytest.mark.parametrize(
    ("works", "words"),
    [
        (program_works, "run program.toml"),
        pytest.param(child_works, "check plugin.toml --update", marks=pytest.mark.slow),
        pytest.param(server_waits, "score {quick} {result}", marks=pytest.mark.slow),
    ],
    ids=["program", "plug-in", "server"],
)
def test_a_killed_command_leaves_no_process(
    works: Callable[[int], bool], words: str, folder: Path, quick: Dataset, quick_result: Path
) -> None:
    made = words.format(quick=quick.root, result=quick_result).split()
    assert kill_in_the_middle(folder, works, *made) == []
