"""Workflows of the templates, step by step as GitHub's runner would run them.

`python benchmarks/workflows.py [KIND ...]` builds the wheel. For each template it writes the folder
and the baseline, as README.md says, and runs each `run:` of the workflow in a fresh environment
with an empty home; then again in another one with the caches of the first, as actions/cache does.
It prints each step with its seconds, and ends with exit code 1 if one fails. Steps that use actions
are not run.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.installs import ROOT, build

KINDS = ("gate", "solver", "suite")
_STEP = re.compile(r"^ +(?:- )?run: (.*)$", re.MULTILINE)
_PLUG_INS = re.compile(r"^  (SABENCH_PLUGINS): (.*)$", re.MULTILINE)


def main() -> None:
    """Run the workflows of the given templates, or of all."""
    with tempfile.TemporaryDirectory(prefix="sabench-workflows-") as folder:
        wheel = build(Path(folder))
        for kind in sys.argv[1:] or KINDS:
            home = Path(folder) / kind
            home.mkdir()
            run_workflow(kind, wheel, home)


def run_workflow(kind: str, wheel: Path, home: Path) -> None:
    """Write a template into a home and run the steps of its workflow twice."""
    file = ROOT / "templates" / kind / ".github" / "workflows" / "sabench.yml"
    text, bin_folder = file.read_text(encoding="utf-8"), home / "environment" / "bin"
    own = {"HOME": str(home), "PATH": f"{bin_folder}:/usr/bin:/bin", "RUNNER_OS": "Linux"}
    own |= {"SABENCH": f"{wheel}[full]", "PYTHON": "3", "GITHUB_OUTPUT": str(home / "output")}
    own |= dict(_PLUG_INS.findall(text))
    steps = _STEP.findall(text)
    install = next(words for words in steps if words.startswith("pip"))
    before = [install, f"sabench new {kind} repository"]
    before += [] if kind == "suite" else ["cd repository && pytest --sabench-update"]
    for title, every, folder in (
        ("before", before, home),
        ("first", steps, home / "repository"),
        ("cached", steps, home / "repository"),
    ):
        shutil.rmtree(bin_folder.parent, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", bin_folder.parent], check=True)
        for words in every:
            run_step(f"{kind}, {title}", words, folder, own)
        if title == "before":
            shutil.rmtree(home / ".cache")  # the runner is another machine


def run_step(title: str, words: str, folder: Path, own: dict[str, str]) -> None:
    """Run a step as the runner's shell does; end if it fails."""
    start = time.monotonic()
    shell = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", words]
    done = subprocess.run(shell, cwd=folder, env=own, capture_output=True, text=True, check=False)
    print(f"{title}: {time.monotonic() - start:.1f} s: {words}", flush=True)
    if title.endswith("cached") and not words.startswith("pip"):
        print(done.stdout[-4000:])
    if done.returncode:
        sys.exit(f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}")


if __name__ == "__main__":
    main()
