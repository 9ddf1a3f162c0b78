"""Ends of commands: success, or one sentence and the exit code 2."""

import subprocess


def succeed(done: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    """Check the exit code 0."""
    assert done.returncode == 0, done.stderr
    return done


def refuse(done: subprocess.CompletedProcess[str], *words: str) -> subprocess.CompletedProcess[str]:
    """Check the exit code 2 and a complaint without traceback that holds all the words."""
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in " ".join(done.stderr.split())
    return done
