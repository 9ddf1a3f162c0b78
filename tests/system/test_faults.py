"""Bad input, faults and kills: one sentence, exit code 2, no partial files, and no process left."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import psutil
import pytest

import sabench
from sabench.dataset.hdf5 import create_hdf5, delay_interrupts
from sabench.dataset.reader import Dataset
from sabench.dataset.schema import seal
from sabench.dataset.verification import verify
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from tests.conftest import ROOT, Command
from tests.helpers.commands import limit_files, local_records, refuse
from tests.helpers.plug_ins import write_solver
from tests.helpers.refusals import refused
from tests.helpers.untrusted import reseal


@pytest.fixture
def copy(quick: Dataset, tmp_path: Path) -> Path:
    return Path(shutil.copytree(quick.root, tmp_path / "copy"))


@pytest.mark.slow
def test_every_single_flipped_bit_is_found(copy: Path) -> None:
    rng = np.random.default_rng(7)
    files = sorted(path for path in copy.rglob("*") if path.is_file())
    assert len(files) == 12
    for file in files:
        whole = file.read_bytes()
        dense = range(0, len(whole) * 8, 97)
        for position in (
            dense if file.name == "manifest.json" else rng.integers(0, len(whole) * 8, 6)
        ):
            damaged = bytearray(whole)
            damaged[position // 8] ^= 1 << (position % 8)
            file.write_bytes(damaged)
            faults = verify(copy)
            assert any(file.name in fault for fault in faults), (file, position)
        file.write_bytes(whole)
    assert verify(copy) == []


def test_verify_names_missing_and_foreign_files(copy: Path, command: Command) -> None:
    (copy / "images/frame_0000/camera_02.exr").unlink()
    (copy / "notes.txt").write_text("mine")
    done = command("verify", copy)
    assert done.returncode == 1
    assert "camera_02.exr: missing" in done.stdout
    assert "notes.txt: a file that the manifest does not list" in done.stdout


@pytest.mark.usefixtures("late_probe")
def test_verify_says_what_is_open(copy: Path, command: Command) -> None:
    """It is neither intact nor damaged: another exit code than that of a fault."""
    done = command("verify", copy)
    refuse(done)
    assert done.stdout == ""


def test_faults_are_short_sentences(copy: Path) -> None:
    cameras = json.loads((copy / "cameras.json").read_text())
    for camera in cameras["cameras"]:
        for key in ("rows", "columns", "pixel_mm", "principal_distance_mm", "focal_length_mm"):
            camera[key] = "x" * 500
    (copy / "cameras.json").write_text(json.dumps(cameras))
    (copy / ("n" * 250)).write_text("long")
    (copy / "two\nlines").write_text("")
    reseal(copy)
    (copy / "unlisted\nfile").write_text("")
    for _ in range(2):
        faults = verify(copy)
        assert len(faults) == 1
        assert max(map(len, faults)) <= 400
        assert all(fault.isprintable() for fault in faults)
        (copy / "unlisted\nfile").unlink(missing_ok=True)
    assert any("faults: cameras.0.rows: expected a valid integer" in fault for fault in faults), (
        faults
    )


def test_no_path_is_followed_outside(copy: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    shutil.copy(copy / "truth.h5", secret)
    (copy / "truth.h5").unlink()
    (copy / "truth.h5").symlink_to(secret)
    assert any("truth.h5" in fault for fault in verify(copy))
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["files"]["../secret"] = manifest["files"].pop("truth.h5")
    (copy / "manifest.json").write_text(seal(manifest))
    assert any("../secret" in fault for fault in verify(copy))


def test_hdf5_link_out_of_the_file_is_refused(quick: Dataset, copy: Path, tmp_path: Path) -> None:
    with h5py.File(copy / "truth.h5", "r+") as file:
        del file["frames/0000/position_mm"]
        file["frames/0000/position_mm"] = h5py.ExternalLink(
            str(quick.root / "truth.h5"), "/frames/0000/position_mm"
        )
    with refused("truth.h5", "frames/0000/position_mm"):
        sabench.open_dataset(copy).particles(0)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def test_missing_and_truncated_images_and_truth(copy: Path, command: Command) -> None:
    image = copy / "images/frame_0000/camera_01.tif"
    truncate(image)
    refuse(command("solve", "msa", copy, "-o", "r.h5"), "camera_01.tif")
    image.unlink()
    refuse(command("solve", "msa", copy, "-o", "r.h5"), "camera_01.tif")
    truncate(copy / "truth.h5")
    refuse(command("score", copy, "truth"), "truth.h5")
    output = command("verify", copy)
    assert output.returncode == 1
    assert len(output.stdout.splitlines()) == 2
    assert "camera_01.tif" in output.stdout
    assert "truth.h5" in output.stdout
    (copy / "manifest.json").unlink()
    refuse(command("score", copy, "truth"), "manifest.json")


@pytest.mark.parametrize(
    ("table", "damage", "key"),
    [
        ("cameras", {"name": "left"}, "left.tif"),
        ("grid", {"shape": [100_000] * 3}, "grid"),
    ],
)
def test_rigs_that_cannot_be_solved(
    copy: Path, tmp_path: Path, command: Command, table: str, damage: dict[str, Any], key: str
) -> None:
    rig = json.loads((copy / "cameras.json").read_text())
    (rig["cameras"][1] if table == "cameras" else rig[table]).update(damage)
    (copy / "cameras.json").write_text(json.dumps(rig))
    refuse(command("solve", "msa", copy, "-o", "r.h5"), key)
    assert list(tmp_path.iterdir()) == [copy]


VOLUME = "frames/0000/volume"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (VOLUME, np.float32(np.nan)),
        (VOLUME, np.zeros((3, 4, 5), np.float32)),
        (VOLUME, np.zeros((40, 200, 280), np.int32)),
        ("frames/0000", None),
        ("version", 99),
    ],
    ids=["NaN", "shape", "kind", "no frame", "version"],
)
def test_bad_results_are_refused(
    quick: Dataset, quick_result: Path, tmp_path: Path, command: Command, name: str, value: Any
) -> None:
    bad = tmp_path / "bad.h5"
    shutil.copy(quick_result, bad)
    with h5py.File(bad, "r+") as file:
        if name in file.attrs:
            file.attrs[name] = value
        elif np.ndim(value) or value is None:
            del file[name]
            file.update({} if value is None else {name: value})
        else:
            file[name][3, 5, 7] = value
    refuse(command("score", quick.root, bad), "bad.h5", name)


def test_bad_command_lines(
    quick: Dataset, command: Command, tmp_path: Path, quick_toml: str
) -> None:
    (tmp_path / "typo.toml").write_text(quick_toml.replace("fluid_index", "fluid_indx"))
    solve = ("msa", quick.root, "-o", "r.h5", "-p")
    for words, keys in (
        (("solve", "masa", quick.root, "-o", "r.h5"), ("masa", "msa")),
        (("solve", *solve, "kk=3"), ("kk", "k")),
        (("solve", *solve, "k=lots"), ("k", "lots")),
        (("solve", *solve, "k"), ("name=value",)),
        (("generate", "quick", "-o", "d", "--backend", "povray"), ("mitsuba", "splat")),
        (("generate", "quick", "-o", "d", "--seed", "-1"), ("seed",)),
        (("generate", "quick"), ("--output",)),
        (("generate", "quick", "-o", quick.root), ("quick",)),
        (("run", "quik"), ("quik", "quick")),
        (("generate", "typo.toml", "-o", "d"), ("fluid_indx", "fluid_index")),
    ):
        refuse(command(*words), *keys)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["typo.toml"]


@pytest.mark.slow
def test_a_disk_that_takes_no_more(quick: Dataset, own_process: Command, tmp_path: Path) -> None:
    """A limit on the size of files stands in for it: writes fail with the system's error."""
    for words in (
        ("generate", "quick", "-o", "full.h5", "--backend", "splat"),
        ("solve", "msa", quick.root, "-o", "full.h5", "-p", "k=0"),
    ):
        refuse(own_process(*words, preexec_fn=limit_files), "full.h5", "File too large")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory, quick_toml: str) -> tuple[Path, str]:
    """A scene of many frames, and the hash of its data set."""
    folder = tmp_path_factory.mktemp("many")
    text = quick_toml.replace("frames = 1", "frames = 40").replace("diameter_spread = 0.1", "")
    (folder / "many.toml").write_text(text)
    made = sabench.generate(folder / "many.toml", folder / "set", backend="splat")
    return folder / "many.toml", made.content_hash


def interrupt(scene: Path, folder: Path, number: int, *more: str, at_work: bool) -> tuple[int, str]:
    """Send a signal to a command that starts up or works; return its exit code and complaint."""
    words = [sys.executable, "-m", "sabench", "generate", str(scene), "-o", "set"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [*words, "--backend", "splat", *more], env=environment, cwd=folder, stderr=subprocess.PIPE
    ) as process:
        end = time.monotonic() + 60.0
        while at_work and not list(folder.glob(".*.parts-*/views/*.npz")):
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(0.05)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    return process.returncode, errors.decode()


@pytest.mark.slow
def test_killed_at_any_moment_nothing_verifies_and_it_goes_on_to_the_same_bytes(
    tmp_path: Path, many: tuple[Path, str]
) -> None:
    folder = tmp_path / "k"
    folder.mkdir()
    for at_work in (False, True):
        ended, _ = interrupt(many[0], folder, signal.SIGKILL, at_work=at_work)
        assert ended == -signal.SIGKILL
        for left in folder.iterdir():
            assert left.name.startswith((".set.parts-", ".set.partial-"))
            assert verify(left)
        with pytest.raises(InputError):
            verify(folder / "set")
    assert sabench.generate(many[0], folder / "set", backend="splat").content_hash == many[1]
    assert [entry.name for entry in folder.iterdir()] == ["set"]


@pytest.mark.slow
def test_ctrl_c_at_any_moment_ends_in_a_sentence_and_keeps_what_is_finished(
    tmp_path: Path, many: tuple[Path, str]
) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    ended, errors = interrupt(many[0], folder, signal.SIGINT, "--jobs", "2", at_work=True)
    assert ended == 2, errors
    assert "Traceback" not in errors
    assert "sabench: interrupted" in errors
    (left,) = folder.iterdir()
    assert left.name.startswith(".set.parts-")
    assert list(left.glob("views/*.npz"))
    assert sabench.generate(many[0], folder / "set", backend="splat").content_hash == many[1]


def test_ctrl_c_within_a_destructor_is_not_lost(tmp_path: Path) -> None:
    """Python ignores what a destructor raises."""
    code = (
        "import os, signal, sys, time\n"
        "from sabench.cli import main as command\n"
        "class Interrupted:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        time.sleep(0.2)\n"
        "def work(**words):\n"
        "    Interrupted()\n"
        "    time.sleep(30.0)\n"
        "command.app = work\n"
        "command.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith(b"sabench: interrupted")


SLEEP = 'print("began", file=sys.stderr, flush=True)\ntime.sleep(60.0)'


@pytest.mark.slow
def test_ctrl_c_in_a_suite_keeps_what_is_finished(tmp_path: Path) -> None:
    """The interrupt goes to the command and to the solver's process. As it does from a terminal."""
    write_solver(tmp_path / "mine", "sleeper", SLEEP)
    (tmp_path / "s.toml").write_text(
        'title = "t"\nscenes = ["quick"]\nbackend = "splat"\n'
        'solvers = [{ name = "msa" }, { name = "sleeper" }]\n'
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT), "SABENCH_PLUGINS": str(tmp_path / "mine")}
    words = [sys.executable, "-m", "sabench", "run", "s.toml"]
    with subprocess.Popen(
        words, env=environment, cwd=tmp_path, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stderr is not None
        assert any(b"began" in line for line in process.stderr)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 2, errors
    assert b"Traceback" not in errors
    assert errors.count(b"sabench: interrupted") == 1
    assert [record["solver"] for record in local_records(tmp_path)] == ["msa"]
    assert not list(tmp_path.rglob("*.partial-*"))


def write_for_ever(path: Path, written: list[str]) -> None:
    with create_hdf5(path) as (file, check):
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        end = time.monotonic() + 20.0
        while time.monotonic() < end:
            with delay_interrupts():
                file.create_dataset(str(len(written)), data=np.zeros(300))
                file.flush()
            check()
            written.append("")


def test_ctrl_c_inside_hdf5_is_not_lost(tmp_path: Path) -> None:
    """The interrupt comes while HDF5 calls back into Python; it arrives after the write."""
    written: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        write_for_ever(tmp_path / "a.h5", written)
    with h5py.File(tmp_path / "a.h5", "r") as again:
        assert len(again) >= len(written) > 0


def test_the_next_write_removes_what_a_killed_one_left(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    left = tmp_path / f".set.partial-{ended.pid}"
    left.mkdir()
    (left / "half").write_text("half")
    with complete_or_nothing(tmp_path / "set") as path:
        path.write_text("whole")
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]


def test_overwriting_keeps_the_old_one_until_the_new_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "set"
    target.mkdir()
    (target / "old").write_text("old")
    with refused("on the way"), complete_or_nothing(target, overwrite=True) as path:
        path.mkdir()
        raise InputError("on the way")
    assert (target / "old").read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_overwriting_deletes_no_files_of_others(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set/a.jpg").touch()
    for name, wanted in ("set", "a folder with a.jpg"), ("set/a.jpg", "a file"), ("~/set", "~"):
        with refused(wanted), complete_or_nothing(tmp_path / name, overwrite=True) as path:
            path.mkdir()
            (path / "b.jpg").touch()
    assert [entry.name for entry in tmp_path.rglob("*")] == ["set", "a.jpg"]


BUSY = "while True: pass"
MARK = "SABENCH_TEST_OF_KILLS"  # variable of all descendants of a command
PROGRAM = f"""#!{sys.executable}
import subprocess, sys
busy = "{BUSY}"
child = subprocess.Popen([sys.executable, "-c", busy])
exec(busy)
"""
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
    write_solver(tmp_path / "mine", "endless", BUSY)
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
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
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
        return any(cpu_s(one) > _BUSY_S for s in servers for one in s.children(recursive=True))
    return False


@pytest.mark.slow
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
