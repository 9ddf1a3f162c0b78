"""Another program in a process of its own: what it prints is kept out of ours, its crash is only its own, and its memory is counted."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.progress import track

_SAID = 300  # characters of a program's last words that an error repeats


def missing(module: str, package: str) -> str | None:
    """Why a package of the extra `competitors` cannot be used, or None if it is there."""
    if importlib.util.find_spec(module):
        return None
    return f"the package {package} is not installed: pip install sabench[competitors]"


def run(module: str, folder: Path, what: str, mark: str, steps: int) -> None:
    """Run `python -m MODULE FOLDER`, with a bar that moves at every line of its output that has `mark` in it.

    Raises
    ------
    InputError
        It ended by a signal, or with another exit code than 0; the text has its last words.
    """
    log = folder / "log.txt"
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", module, str(folder)],
            stdout=subprocess.PIPE,
            stderr=errors,
            cwd=folder,
            env=_paths(),
        )
        assert process.stdout is not None
        with process.stdout as out, log.open("ab") as kept:
            bar = iter(track(range(steps), what))
            for line in out:
                kept.write(line)
                if mark.encode() in line:
                    next(bar, None)
            for _ in bar:  # what was not announced
                pass
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    memory.add_child(used.ru_maxrss * (1024 if sys.platform != "darwin" else 1) / 1e6)
    if process.returncode:
        last = " ".join(log.read_text(encoding="utf-8", errors="replace").split())[-_SAID:]
        how = (
            f"signal {-process.returncode}"
            if process.returncode < 0
            else f"exit code {process.returncode}"
        )
        raise InputError(
            f"{what}: expected it to end well, but it ended with {how}; its last words: {last or 'none'}"
        )


def _paths() -> dict[str, str]:
    """The environment in which the program finds what this process finds, sabench included."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
