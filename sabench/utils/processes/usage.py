"""Processes of a program, and the memory and disk space that they use."""

from __future__ import annotations

import contextlib
import os
import subprocess
from pathlib import Path

import psutil


def held_mb(process: subprocess.Popen[bytes]) -> float:
    """Return the resident memory of a program's processes together, in MB.

    1 MB is 10^6 bytes.
    """
    held = 0
    for member in family(process):
        with contextlib.suppress(psutil.Error):
            held += member.memory_info().rss
    return held / 1e6


def family(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Return a program's process, all below it, and all of its session."""
    found = {}
    # once its end is known, the system may give the number to another process
    if process.returncode is None:
        with contextlib.suppress(psutil.Error):
            head = psutil.Process(process.pid)
            found = {one.pid: one for one in (head, *head.children(recursive=True))}
    for other in psutil.pids():
        if other not in found:
            with contextlib.suppress(psutil.Error, OSError):
                if os.getsid(other) == process.pid:
                    found[other] = psutil.Process(other)
    return list(found.values())


def find_marked(variable: str, token: str) -> list[psutil.Process]:
    """Return the processes with a token in their environment, wherever they are."""
    found = []
    for one in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if one.environ().get(variable) == token:
                found.append(one)
    return found


def size_mb(folder: Path) -> float:
    """Return the disk space of all files below a folder, in MB.

    Links are not followed.
    """
    blocks = 0
    for path, _, files in os.walk(folder):
        for name in files:
            with contextlib.suppress(OSError):
                # a path object for each of many files is slow
                blocks += os.lstat(os.path.join(path, name)).st_blocks  # noqa: PTH118
    return blocks * 512 / 1e6
