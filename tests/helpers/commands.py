"""Ends of commands: success, or one sentence and the exit code 2."""

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.helpers.refusals import check_sentence

ROOT = Path(__file__).resolve().parents[2]


def run_python(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run Python in a child process that imports this checkout; `env` is added to ours."""
    own = os.environ | {"PYTHONPATH": str(ROOT)} | options.pop("env", {})
    settings = {"capture_output": True, "text": True, "check": False, "env": own} | options
    line = [sys.executable, *map(str, words)]
    done: subprocess.CompletedProcess[str] = subprocess.run(line, **settings)
    return done


def succeed(done: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    assert done.returncode == 0, done.stderr
    return done


def refuse(done: subprocess.CompletedProcess[str], *keys: str) -> subprocess.CompletedProcess[str]:
    """Check the exit code 2 and one complaint, of every key, that is that of the snapshot."""
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    lines = done.stderr.splitlines()
    (first,) = (number for number, line in enumerate(lines) if line.startswith("sabench: "))
    check_sentence(" ".join(" ".join(lines[first:]).split()), *keys)
    return done


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


def local_records(folder: Path) -> list[dict[str, Any]]:
    text = (folder / "leaderboard/records/local.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


def local_page(folder: Path) -> str:
    return (folder / "leaderboard/index.html").read_text(encoding="utf-8")
