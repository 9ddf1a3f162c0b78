"""Solvers that cheat gain nothing where the system can confine them."""

import os
import shutil
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

import sabench
from sabench.dataset.reader import Dataset
from sabench.tasks.solve_and_score import solve
from sabench.utils.errors import InputError
from sabench.utils.processes.confinement import can_confine
from tests.helpers import cheats
from tests.helpers.refusals import refused

pytestmark = pytest.mark.skipif(
    not can_confine(), reason="this system does not let this user confine a process"
)
TOKEN = "a-word-that-nobody-else-has"
HARMFUL = (  # where nothing stops them
    "outlive",
    "change sabench",
    "leave shared memory",
    "leave a file in /tmp",
    "make mounts writable",
    "enter another namespace",
    "write to the data set",
    "trace others",
)


@pytest.fixture
def place(quick: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(quick.root, tmp_path / "set")
    (tmp_path / "secret.toml").write_text('secret = "0123456789abcdef"\n')
    monkeypatch.setenv("A_TOKEN", TOKEN)
    monkeypatch.setenv("SABENCH_PLUGINS", str(tmp_path / "mine"))
    (tmp_path / "mine" / "solvers").mkdir(parents=True)
    return tmp_path


@pytest.fixture
def port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def check_outside(place: Path, data: Dataset) -> None:
    """Check that nothing outside has changed, and that nothing lives on."""
    assert sabench.verify(place / "set") == []
    assert data.content_hash
    assert not (place / "mark").exists()
    for planted in (Path("/dev/shm/planted"), Path("/tmp/planted"), Path("/usr/planted")):
        assert not planted.exists()
    assert not (Path(sabench.__file__).parent / "planted.py").exists()
    assert not [p for p in psutil.process_iter(["cmdline"]) if "4321" in (p.info["cmdline"] or ())]


def attempt(place: Path, port: int, kind: str) -> list[str]:
    """Let a cheat try all tricks; list those that gained something."""
    names = (str(place / name) for name in ("set", "secret.toml", "mark"))
    facts = (*names, port, TOKEN, os.getpid())
    if kind == "program":
        solver = place / "bin" / "cheat"
        solver.parent.mkdir()
        solver.write_text(cheats.program(facts, sys.executable))
        solver.chmod(0o755)
    else:
        solver = place / "mine" / "solvers" / "cheat.py"
        solver.write_text(cheats.plugin(kind, facts))
    name = str(solver) if kind == "program" else "cheat"
    with pytest.raises(InputError) as failure:
        solve(name, sabench.open_dataset(place / "set"), place / "r.h5")
    return cheats.gained(str(failure.value))


@pytest.mark.slow_but_first
@pytest.mark.parametrize("kind", ["reconstruction", "particles", "program"])
def test_a_cheat_gains_nothing(place: Path, port: int, kind: str) -> None:
    assert attempt(place, port, kind) == []
    check_outside(place, sabench.open_dataset(place / "set"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["particles", "program"])
def test_without_confinement_tricks_work_and_the_result_says_so(
    place: Path, port: int, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the tricks themselves would be wrong."""
    monkeypatch.setattr("sabench.tasks.visible_files.can_confine", lambda: False)
    monkeypatch.setattr("sabench.tasks.solve_and_score.can_confine", lambda: False)
    harmless = [name for name in cheats.TRICKS if name not in HARMFUL]
    monkeypatch.setattr(cheats, "TRICKS", {name: cheats.TRICKS[name] for name in harmless})
    gained = attempt(place, port, kind)
    assert {"read the truth", "read the seed", "read the secret", "look around"} <= set(gained)
    assert {"connect", "read command lines", "signal others"} <= set(gained)
    (place / "mark").unlink()  # what "write outside" has left
    assert solve("msa", sabench.open_dataset(place / "set"), place / "r.h5").isolated is False


THIEF = """#!{python}
import sys

from sabench.api import Parameters, Solver


def read():
    words = ""
    for place in {places!r}:
        try:
            words += open(place).read()
        except OSError as error:
            words += error.strerror
    return words


class Thief(Solver):
    name = "thief"

    class Parameters(Parameters):
        words: str = read()

    def solve(self, case):
        raise RuntimeError(f"read [{{read()}}]")
"""
PROGRAM_THIEF = "#!{python}\nimport sys\nsys.exit(str([open(one).read() for one in {places!r}]))\n"
SUITE = """title = "t"
backend = "splat"
solvers = [{ name = "thief" }, { name = "mine/solvers/steal", task = "reconstruction" }]
[[cases]]
scene = "quick"
set = { "particles.count" = 40, "volume.size_mm" = [7.0, 5.0, 2.0] }
"""


@pytest.mark.slow
def test_the_secret_of_a_private_test_set_is_hidden_where_it_would_be_seen(place: Path) -> None:
    """A plug-in would see it as it is imported and as it solves, a program in its folder."""
    folder = place / "mine" / "solvers"
    secret, words = folder / "secret.toml", 'secret = "0123456789abcdef"\nseeds = 1\n'
    secret.write_text(words)
    (place / "link").symlink_to(folder)
    facts = {"python": sys.executable, "places": [str(secret)]}
    (folder / "thief.py").write_text(THIEF.format(**facts))
    (folder / "steal").write_text(PROGRAM_THIEF.format(**facts))
    (folder / "steal").chmod(0o755)
    (place / "s.toml").write_text(SUITE)
    for shown in (secret, place / "link" / "secret.toml"):
        folders = (place / "work", place / "leaderboard")
        plugin, program = sabench.run_suite(place / "s.toml", *folders, secret=shown)
        assert plugin["parameters"] == {"words": ""}
        assert "RuntimeError: read [] (thief.py, line" in plugin["error"]
        assert "['']" in program["error"]
    assert secret.read_text() == words


TWO_FACED = """
import traceback

import numpy as np

from sabench.api import FoundParticles, ParticleSolver, Reconstruction, Solver

if "run_plug_in" in [frame.name for frame in traceback.extract_stack()]:
    class TwoFaced(ParticleSolver):
        name = "two_faced"

        def solve(self, case):
            return [FoundParticles(np.zeros((1, 3))) for _ in range(len(case))]
else:
    class TwoFaced(Solver):
        name = "two_faced"

        def solve(self, case):
            return Reconstruction(np.zeros(case.grid.shape, dtype=np.float32))
"""


def test_a_result_of_another_task_than_described_is_refused(place: Path) -> None:
    (place / "mine" / "solvers" / "two_faced.py").write_text(TWO_FACED)
    data = sabench.open_dataset(place / "set")
    with refused("two_faced", "reconstruction", "particles"):
        solve("two_faced", data, place / "r.h5")
    assert not (place / "r.h5").exists()


LINKER = '''"""Links."""

import os
import sys
import threading
import time

import numpy as np

from sabench.api import Observation, Reconstruction, Solver


class Linker(Solver):
    """Leaves a link to somebody else's result in place of its own."""

    name = "linker"

    def solve(self, case: Observation) -> Reconstruction:
        frame = sys._getframe()
        while "out" not in frame.f_locals:
            frame = frame.f_back
        replace = os.replace
        os.symlink("{better}", str(frame.f_locals["out"]) + ".link")
        os.replace(str(frame.f_locals["out"]) + ".link", frame.f_locals["out"])
        os.link = os.rename = os.replace = lambda *words, **more: None
        type(frame.f_locals["out"]).replace = type(frame.f_locals["out"]).rename = os.replace
        return Reconstruction(np.zeros(case.grid.shape, dtype=np.float32))
'''


def test_a_link_to_another_result_is_not_taken(place: Path) -> None:
    data = sabench.open_dataset(place / "set")
    better = solve("msa", data, place / "better.h5").path
    file = place / "mine" / "solvers" / "linker.py"
    file.write_text(LINKER.format(better=better))
    with refused("linker"):
        solve("linker", data, place / "r.h5")
    assert not (place / "r.h5").exists()
