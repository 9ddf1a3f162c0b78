"""Shared fixtures: a small data set, and the command as users run it.

Mitsuba renders the data set through glass, once for all system tests.
"""

import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# Tests run side by side, one process a core. Threads that wait for each other on a busy core take
# it from the neighbour: 59 s of CPU in place of 8 s for one bundle adjustment, measured on 2 cores.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["OMP_WAIT_POLICY"] = "PASSIVE"

import pytest
from _pytest.runner import runtestprotocol
from filelock import FileLock

import sabench
from sabench.cli.main import main
from sabench.dataset.reader import Dataset
from sabench.evaluation.timed_solving import reference_s
from sabench.geometry.camera import Camera
from sabench.geometry.camera_model import CameraModel
from sabench.utils import backend
from tests.helpers import commands, refusals

Command = Callable[..., "subprocess.CompletedProcess[str]"]
ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 2.0  # CPU time of a test that is not marked `slow`, on a machine as fast as below
_REFERENCE_S = 0.015  # of the reference kernel on that machine
_seconds = pytest.StashKey[float]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden", action="store_true", help="store the figures of the quick scene anew"
    )
    parser.addoption(
        "--update-sentences", action="store_true", help="store the sentences of errors anew"
    )


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Fail a test that takes over `LIMIT_S` and is not marked `slow`.

    CPU time of the test and its children counts: neighbours do not change it. It is a multiple of
    the reference kernel's time, so that a slow machine has as much of it. Fixtures do not count.
    A test above the limit runs once more and the smaller time counts, because the first run
    compiles kernels and fills caches.
    """
    if item.get_closest_marker("slow"):
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    first = item.stash.get(_seconds, 0.0)
    if first > LIMIT_S and all(report.passed for report in reports):
        again = runtestprotocol(item, nextitem=nextitem, log=False)
        seconds = min(first, item.stash[_seconds])
        slower = max(1.0, reference_s(time.process_time) / _REFERENCE_S)
        limit = LIMIT_S * slower
        if not all(report.passed for report in again):
            reports = again
        elif seconds > limit:
            reports[1].outcome = "failed"
            reports[1].longrepr = (
                f"{item.nodeid}: expected at most {limit:.1f} s of CPU time, got {seconds:.1f} s. "
                "Use a smaller case, or mark the test `slow`."
            )
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_runtest_setup() -> None:
    """Count the sentences of a test from its first one, in a second run, too."""
    refusals.begin()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Measure the CPU time of a test and of the children that it waited for."""
    start = sum(os.times()[:4])
    try:
        yield
    finally:
        item.stash[_seconds] = sum(os.times()[:4]) - start


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all cases but the first of a test `slow_but_first` as slow."""
    for item in items:
        if item.get_closest_marker("slow_but_first") and any(item.callspec.indices.values()):  # type: ignore[attr-defined]
            item.add_marker("slow")


def pytest_configure(config: pytest.Config) -> None:
    """Read the options; look for garbage less often.

    The compiler of kernels makes so many objects that a tenth of its time went into this search.
    """
    refusals.update = config.getoption("--update-sentences")
    gc.set_threshold(50_000, 10, 10)


def pytest_collection_finish() -> None:
    """Look for no garbage among what all tests import."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def hears_ctrl_c() -> None:
    """Let child processes receive Ctrl-C, which some tests send to theirs.

    A shell's background job and its children ignore it.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", autouse=True)
def one_rendering_thread() -> None:
    """Render with one thread a process, since the tests run in parallel.

    With more, ten small images of bubbles take 11 s of CPU time in place of 7 s.
    """
    backend.limit_threads(1)


def pinholes(cameras: Iterable[CameraModel]) -> tuple[Camera, ...]:
    """Cameras of which a test knows that they are pinholes behind walls."""
    return tuple(camera for camera in cameras if isinstance(camera, Camera))


@contextmanager
def shared_folder(factory: pytest.TempPathFactory) -> Generator[Path]:
    """Lend a folder of all processes of this run to one at a time."""
    folder = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with FileLock(folder / "shared.lock"):
        yield folder / "shared"


@pytest.fixture(scope="session")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The quick scene, seed 1. Do not change it: copy it."""
    with shared_folder(tmp_path_factory) as folder:
        if (folder / "quick").exists():
            return sabench.open_dataset(folder / "quick")
        return sabench.generate("quick", folder / "quick", seed=1, backend="mitsuba")


@pytest.fixture(scope="session")
def quick_result(quick: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The multiplicative synthetic aperture's result on `quick`."""
    with shared_folder(tmp_path_factory) as folder:
        path = folder / "msa.h5"
        if not path.exists():
            sabench.solve("msa", quick, path)
        return path


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Command:
    """Run `sabench ARGUMENTS` in an empty folder, in this process.

    This process has done all imports, so that the command starts quickly.
    """

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        words = [str(argument) for argument in arguments]
        capfd.readouterr()
        with monkeypatch.context() as patch:
            patch.chdir(tmp_path)
            patch.setattr(sys, "argv", ["sabench", *words])
            patch.setattr(sys, "unraisablehook", sys.unraisablehook)  # the command sets it
            with pytest.raises(SystemExit) as end:
                main()
        code = end.value.code
        return subprocess.CompletedProcess(
            words, code if isinstance(code, int) else 0, *capfd.readouterr()
        )

    return run


@pytest.fixture
def own_process(tmp_path: Path) -> Command:
    """Run `sabench ARGUMENTS` in an empty folder, in a child process as a user would.

    For tests that depend on the process.
    """

    def run(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
        settings = {"cwd": tmp_path, "timeout": 300} | options
        return commands.run_python("-m", "sabench", *arguments, **settings)

    return run


@pytest.fixture(scope="session")
def quick_toml() -> str:
    """Text of the quick scene, to be changed."""
    return (ROOT / "scenes" / "quick.toml").read_text(encoding="utf-8")
