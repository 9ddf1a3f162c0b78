"""Isolated calls, and reading in limited time."""

import operator
import os
import time
from pathlib import Path

import h5py
import pytest

from sabench.dataset.verification import probe
from sabench.utils.errors import InputError, UncheckedError
from sabench.utils.processes import call
from sabench.utils.processes.call import call_isolated, read_isolated
from tests.conftest import ROOT
from tests.helpers.commands import run_python, succeed
from tests.helpers.refusals import refused


def pid_and(variable: str) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get(variable)


def refuse() -> None:
    raise InputError("no")


def break_off(*_: object) -> None:
    os.abort()


def test_the_child_has_the_environment_of_the_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its server started earlier, with another one."""
    assert call_isolated(operator.add, 2, 3, doing="sum") == 5
    monkeypatch.setenv("SABENCH_TEST", "now")
    child, value = call_isolated(pid_and, "SABENCH_TEST", doing="look")
    assert value == "now"
    assert child != os.getpid()
    monkeypatch.delenv("SABENCH_TEST")
    assert call_isolated(pid_and, "SABENCH_TEST", doing="look")[1] is None


def test_faults_become_input_errors() -> None:
    with refused("no"):
        call_isolated(refuse, doing="sum")
    with refused("sum", "SIGABRT"):
        call_isolated(break_off, doing="sum")
    with refused("sleep", "0.2 s"):
        call_isolated(time.sleep, 60.0, doing="sleep", time_s=0.2)


SLOW_START = """
import os, sys
os.environ["PARENT"] = str(os.getpid())
from sabench.dataset.verification import probe
from sabench.utils.processes import call
from slow_to_import import SlowPath
call._CPU_S = 0.5
probe(SlowPath(sys.argv[1]))
"""
SLOW_MODULE = """
import os, time
from pathlib import PosixPath
if os.getpid() != int(os.environ["PARENT"]):
    time.sleep(2.0)
class SlowPath(PosixPath): pass
"""


def test_files_of_the_current_folder_hide_no_standard_module(tmp_path: Path) -> None:
    (tmp_path / "socket.py").write_text("raise SystemExit('imported')")
    script = tmp_path / "bin" / "script.py"
    script.parent.mkdir()
    script.write_text(
        "import os\nfrom sabench.utils.processes.call import call_isolated\n"
        "assert call_isolated(os.getpid, doing='number') != os.getpid()\n"
    )
    succeed(run_python(script, cwd=tmp_path))


def turn_in_circles(path: Path) -> None:
    while True:
        pass


def wait(path: Path, seconds: float) -> None:
    time.sleep(seconds)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with h5py.File(tmp_path / "a.h5", "w") as made:
        made["values"] = [1.0, 2.0]
    return tmp_path / "a.h5"


@pytest.fixture
def one_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call, "_CPU_S", 0.5)


@pytest.mark.slow
def test_a_process_that_starts_slowly_makes_no_file_damaged(file: Path) -> None:
    """On a busy machine it takes longer to import what it needs than to read the file."""
    (file.parent / "slow_to_import.py").write_text(SLOW_MODULE)
    paths = os.pathsep.join((str(ROOT), str(file.parent)))
    start = time.monotonic()
    succeed(run_python("-c", SLOW_START, file, env={"PYTHONPATH": paths}))
    assert time.monotonic() - start > 2.0  # the process did start slowly


@pytest.mark.slow
@pytest.mark.usefixtures("one_second")
def test_time_that_others_take_does_not_count(file: Path) -> None:
    start = time.monotonic()
    read_isolated(wait, file, 1.5)
    assert time.monotonic() - start > 1.5  # thrice the limit of CPU time


@pytest.mark.slow
@pytest.mark.usefixtures("one_second")
def test_a_file_that_sends_a_library_round_in_circles_is_not_called_damaged(file: Path) -> None:
    probe(file)
    with refused("a.h5", "1 s", kind=UncheckedError):
        read_isolated(turn_in_circles, file)


@pytest.mark.usefixtures("one_second")
def test_a_reader_that_sleeps_is_killed(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call, "_PATIENCE", 0.5)
    with refused("a.h5", "0.5 s", kind=UncheckedError):
        read_isolated(wait, file, 60.0)


def test_a_crash_is_a_fault_of_the_file(file: Path) -> None:
    with refused("SIGABRT") as caught:
        read_isolated(break_off, file)
    assert not isinstance(caught.value, UncheckedError)
