"""Python modules and code run in a child process.

A crash of the child and its output stay there.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

from sabench.utils import memory
from sabench.utils.errors import InputError
from sabench.utils.processes.ending import check_end, kill_if_left, last_line, overdue
from sabench.utils.processes.starting import start_python
from sabench.utils.progress import progress_bar


def missing(module: str, package: str) -> str | None:
    """Say how to install a package of the extra `competitors`.

    Returns None if it is there.
    """
    if importlib.util.find_spec(module):
        return None
    return f"the package {package} is not installed: pip install sabench[competitors]"


def run_module(module: str, folder: Path, name: str, mark: str, steps: int) -> None:
    """Run `python -m MODULE FOLDER` with a progress bar.

    Its memory is counted as this process's.

    Parameters
    ----------
    folder : working directory; the output goes to its file log.txt.
    name : of the program, for the progress bar and errors.
    mark : text of those lines of output that advance the bar.
    steps : length of the bar.

    Raises
    ------
    InputError
        The exit code is not 0; the text quotes the last line of output.
    """
    log = folder / "log.txt"
    with log.open("wb") as errors:
        process = start_python(["-m", module, str(folder)], folder=folder, stderr=errors)
    with kill_if_left(process):
        _follow(process, log, name, mark, steps)
        code = _wait_counting_memory(process)
    check_end(name, code, last_line(log.read_bytes()))


def _follow(process: subprocess.Popen[bytes], log: Path, name: str, mark: str, steps: int) -> None:
    assert process.stdout is not None
    bar = iter(progress_bar(range(steps), name))
    with log.open("ab") as kept:
        for line in process.stdout:
            kept.write(line)
            if mark.encode() in line:
                next(bar, None)
    for _ in bar:  # steps that the program did not announce
        pass


def _wait_counting_memory(process: subprocess.Popen[bytes]) -> int:
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    memory.add_child(used.ru_maxrss * (1024 if sys.platform != "darwin" else 1) / 1e6)
    return process.returncode


def run_code(code: str, name: str, time_s: float) -> str:
    """Run Python code in a child process and return what it prints.

    Raises
    ------
    InputError
        It exceeds its time, or its exit code is not 0; the text quotes its last line of errors.
    """
    process = start_python(["-c", code], stderr=subprocess.PIPE)
    with kill_if_left(process):
        try:
            output, errors = process.communicate(timeout=time_s)
        except subprocess.TimeoutExpired:
            raise InputError(f"{name}: {overdue(time_s)}") from None
    check_end(name, process.returncode, last_line(errors))
    return output.decode("utf-8", "replace").strip()
