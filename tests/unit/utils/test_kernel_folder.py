"""Kernels are compiled again when one that they call has changed in another file."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import sabench
from sabench.utils import compiled, kernel_folder
from sabench.utils.compiled import numba
from sabench.utils.kernel_folder import hash_sources

UTILS = ("code_hash.py", "compiled.py", "installed.py", "kernel_folder.py", "version.py")
CALLEE = """
from sabench.utils.compiled import numba

@numba.njit(cache=True)
def callee():
    return {number}
"""
CALLER = """
from sabench.callee import callee
from sabench.utils.compiled import numba

@numba.njit(cache=True)
def caller():
    return 10 * callee()
"""


def write_package(folder: Path) -> Path:
    source, own = Path(sabench.__file__).parent, folder / "sabench"
    (own / "utils").mkdir(parents=True)
    for name in UTILS:
        shutil.copy(source / "utils" / name, own / "utils")
    for name in ("__init__.py", "__init__.pyi"):
        shutil.copy(source / name, own)
    (own / "caller.py").write_text(CALLER)
    (own / "callee.py").write_text(CALLEE.format(number=1))
    (own / "other.py").write_text("NUMBER = 1\n")
    return own


def call(folder: Path, kernels: Path) -> int:
    # Python reads bytecode again if its source has the same second and size, as where a call takes
    # less than a second.
    own = {"PYTHONDONTWRITEBYTECODE": "1"}
    own |= {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(kernels)}
    words = [sys.executable, "-c", "from sabench.caller import caller; print(caller())"]
    done = subprocess.run(words, env=os.environ | own, cwd=folder, capture_output=True, check=True)
    return int(done.stdout)


@pytest.mark.slow
def test_a_changed_callee_in_another_file_is_not_overlooked(tmp_path: Path) -> None:
    own = write_package(tmp_path)
    for number in (1, 2):
        (own / "callee.py").write_text(CALLEE.format(number=number))
        assert call(tmp_path, tmp_path / "kernels") == 10 * number
    assert len(list((tmp_path / "kernels").rglob("caller.caller-*.nbc"))) == 2


@pytest.mark.slow
def test_another_copy_of_the_same_sources_compiles_nothing(tmp_path: Path) -> None:
    for copy in ("first", "second"):
        write_package(tmp_path / copy)
        assert call(tmp_path / copy, tmp_path / "kernels") == 10
        assert len(list((tmp_path / "kernels").rglob("*.nbc"))) == 2


def test_the_hash_is_that_of_kernels_and_of_all_that_they_import(tmp_path: Path) -> None:
    own = write_package(tmp_path)
    before = hash_sources(own)
    (own / "other.py").write_text("NUMBER = 2\n")  # which no kernel imports
    assert hash_sources(own) == before
    (own / "callee.py").write_text(CALLEE.format(number="1\n\n\nfrom sabench import other"))
    after = hash_sources(own)
    (own / "other.py").write_text("NUMBER = 3\n")
    assert len({before, after, hash_sources(own)}) == 3


def test_numba_stores_kernels_there() -> None:
    folder = kernel_folder.kernel_folder()
    assert str(folder) == numba.config.CACHE_DIR
    assert folder.name.startswith("kernels-")


def test_kernels_of_plug_ins_have_folders_of_their_own() -> None:
    """The hash that names the shared folder leaves them out: see `hash_sources`."""
    package = Path(compiled.__file__).parents[1]
    inside, plug_in = package / "utils" / "a.py", package / "_plugins" / "solvers" / "a.py"
    here = compiled._PlaceInPackage.from_function(write_package, str(inside))
    assert Path(here.get_cache_path()) == kernel_folder.kernel_folder() / "utils"
    assert compiled._PlaceInPackage.from_function(write_package, str(plug_in)) is None


def test_old_folders_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for number, folder in enumerate([tmp_path / f"kernels-{number}" for number in range(8)]):
        folder.mkdir()
        used = time.time() - (number > 0) * 86400.0 * (30 - number)
        os.utime(folder, (used, used))
    (tmp_path / "other").mkdir()
    made = kernel_folder.kernel_folder.__wrapped__()
    assert made.parent == tmp_path
    left = {folder.name for folder in tmp_path.iterdir()}
    assert left == {made.name, "other", "kernels-0"}


def test_a_folder_that_cannot_be_made_is_replaced_by_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    made = kernel_folder.kernel_folder.__wrapped__()
    assert made.is_dir()
    assert tmp_path / "temporary" in made.parents


def test_all_kernels_are_stored_there() -> None:
    package = Path(sabench.__file__).parent
    own = re.compile(r"^\s*import numba|^\s*from numba import .*(njit|prange)", re.MULTILINE)
    files = {one.name for one in package.rglob("*.py") if own.search(one.read_text("utf-8"))}
    assert files == {"compiled.py"}
