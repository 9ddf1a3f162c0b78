"""Ends of commands: success, or one sentence and the exit code 2."""

import json
import subprocess
from pathlib import Path
from typing import Any

from tests.helpers.refusals import check_sentence


def succeed(done: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    """Check the exit code 0."""
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


def local_records(folder: Path) -> list[dict[str, Any]]:
    """Read the records that `sabench run` left in a folder."""
    text = (folder / "leaderboard/records/local.jsonl").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines()]


def local_page(folder: Path) -> str:
    """Read the page that `sabench run` left in a folder."""
    return (folder / "leaderboard/index.html").read_text(encoding="utf-8")
