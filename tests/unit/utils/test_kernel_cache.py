"""Kernels are compiled again when one that they call has changed in another file."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numba

import sabench

PACKAGE = Path(sabench.__file__).parent
CALLEE = '''"""Callee."""

import numba


@numba.njit(cache=True)
def callee() -> int:
    """Return a number."""
    return {number}
'''
CALLER = '''"""Caller."""

import numba

from sabench.callee import callee


@numba.njit(cache=True)
def caller() -> int:
    """Call the other one."""
    return 10 * callee()
'''
SCRIPT = """
import sys
if sys.argv[1] == "first":
    import numba.core.caching
from sabench.caller import caller
print(caller(), sum(caller.stats.cache_hits.values()))
"""


def run(folder: Path, order: str = "sabench") -> tuple[int, int]:
    """Return the caller's answer, and how often it came out of the cache."""
    environment = os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    words = [sys.executable, "-c", SCRIPT, order]
    done = subprocess.run(
        words, env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    answer, hits = done.stdout.split()
    return int(answer), int(hits)


def write_package(folder: Path) -> Path:
    """Copy what stamps kernels, with a kernel that calls another one."""
    own = folder / "sabench"
    shutil.copytree(PACKAGE / "utils", own / "utils", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("__init__.py", "__init__.pyi"):
        shutil.copy(PACKAGE / name, own)
    (own / "caller.py").write_text(CALLER)
    (own / "callee.py").write_text(CALLEE.format(number=1))
    return own


def test_a_changed_callee_in_another_file_is_not_overlooked(tmp_path: Path) -> None:
    own = write_package(tmp_path)
    assert run(tmp_path) == (10, 0)
    assert run(tmp_path) == (10, 1)
    (own / "callee.py").write_text(CALLEE.format(number=2))
    assert run(tmp_path) == (20, 0)
    assert run(tmp_path, "first") == (20, 1)  # the same stamp if numba was imported before sabench
    (own / "other.py").write_text(CALLEE.format(number=3))  # which nothing calls
    assert run(tmp_path) == (20, 1)


def test_kernels_of_other_packages_keep_their_stamps(tmp_path: Path) -> None:
    (tmp_path / "other.py").write_text(CALLEE.format(number=3))
    script = (
        "import sabench, other\n"
        "stamp = other.callee._cache._impl.locator.get_source_stamp()\n"
        "from sabench.images.gaussians import __name__\n"
        "assert not (isinstance(stamp, tuple) and isinstance(stamp[1], str)), stamp\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])}
    subprocess.run([sys.executable, "-c", script], env=environment, cwd=tmp_path, check=True)


def test_an_unreadable_index_counts_as_empty(tmp_path: Path) -> None:
    """A class in a kernel's signature may have moved since; a disk may have been full."""
    write_package(tmp_path)
    assert run(tmp_path) == (10, 0)
    (index,) = (tmp_path / "cache").rglob("caller.caller*.nbi")
    version = pickle.dumps(numba.__version__, protocol=-1)
    for content in (b"cmath\nThereIsNoSuchClass\n.", b"cno_such_module\nname\n.", b"", b"\x80"):
        index.write_bytes(version + content)
        assert run(tmp_path) == (10, 0)
        assert run(tmp_path) == (10, 1)
    index.write_bytes(b"")
    assert run(tmp_path) == (10, 0)
