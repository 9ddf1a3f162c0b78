"""Solvers that cheat gain nothing where the system can confine them."""

from __future__ import annotations

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

pytestmark = pytest.mark.skipif(
    not can_confine(), reason="this system does not let this user confine a process"
)
TOKEN = "a-word-that-nobody-else-has"


@pytest.fixture
def place(quick: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data set of its own, with a secret next to it."""
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


def constants(place: Path, port: int) -> tuple[object, ...]:
    return (
        str(place / "set"),
        str(place / "secret.toml"),
        str(place / "mark"),
        port,
        TOKEN,
        os.getpid(),
    )


def check_outside(place: Path, data: Dataset) -> None:
    """Check that nothing outside has changed, and that nothing lives on."""
    assert sabench.verify(place / "set") == []
    assert data.content_hash
    assert not (place / "mark").exists()
    for planted in (Path("/dev/shm/planted"), Path("/tmp/planted"), Path("/usr/planted")):
        assert not planted.exists()
    assert not (Path(sabench.__file__).parent / "planted.py").exists()
    assert not [
        one for one in psutil.process_iter(["cmdline"]) if "4321" in (one.info["cmdline"] or ())
    ]


@pytest.mark.parametrize("trick", cheats.TRICKS)
def test_a_plug_in_gains_nothing(place: Path, port: int, trick: str) -> None:
    (place / "mine" / "solvers" / "cheat.py").write_text(
        cheats.plugin(trick, constants(place, port))
    )
    data = sabench.open_dataset(place / "set")
    solve("cheat", data, place / "r.h5")  # an InputError with GOT otherwise
    assert sabench.score(data, place / "r.h5")["isolated"] is True
    check_outside(place, data)


@pytest.mark.parametrize("trick", [name for name in cheats.TRICKS if name != "ask the loader"])
def test_a_program_gains_nothing(place: Path, port: int, trick: str) -> None:
    program = place / "bin" / "cheat"
    program.parent.mkdir()
    program.write_text(cheats.program(trick, constants(place, port), sys.executable))
    program.chmod(0o755)
    data = sabench.open_dataset(place / "set")
    with pytest.raises(InputError, match="found nothing"):
        solve(str(program), data, place / "r.h5")
    check_outside(place, data)


@pytest.mark.parametrize("trick", ["read the truth", "read the secret", "read command lines"])
def test_without_confinement_the_tricks_work_and_the_result_says_so(
    place: Path, port: int, trick: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sabench.tasks.visible_files.can_confine", lambda: False)
    file = place / "mine" / "solvers" / "cheat.py"
    file.write_text(cheats.plugin(trick, constants(place, port)))
    data = sabench.open_dataset(place / "set")
    with pytest.raises(InputError, match="GOT"):
        solve("cheat", data, place / "r.h5")
    assert solve("msa", data, place / "r.h5").isolated is False
