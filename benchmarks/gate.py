"""Sensitivity of the gate: planted bugs it catches, honest reruns it passes.

    python benchmarks/gate.py                       # all bugs, 50 reruns: two hours on two cores
    python benchmarks/gate.py --bugs 3 --reruns 2
    python benchmarks/gate.py --skip 20 --narrow --reruns 0
    python benchmarks/gate.py --bugs 0 --reruns 100 --jobs 12   # reruns on a busy machine

Each bug is one line changed in a copy of the source; `sabench check ci` there must end with exit
code 1, and with 0 where nothing was changed. A bug that the gate cannot see names the unit tests
that must fail. `--narrow` runs only the case of `ci` that is meant to catch a bug, and only the
tests of a bug that is theirs to catch. `--jobs` is the number of reruns side by
side. Kernels are compiled anew where a file with kernels, or one that these import, was changed.
Prints a line for every run and a summary; exit code 1 if a bug was missed, a rerun was not silent,
or a replacement does not fit.
"""

import argparse
import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import tomli_w

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.planted_bugs import BUGS, Bug  # noqa: E402

_COPIED = (
    "sabench",
    "solvers",
    "generators",
    "scenes",
    "leaderboard",
    "tests",
    "pyproject.toml",
)


def main() -> None:
    """Run bugs and reruns, and print both tables."""
    parser = argparse.ArgumentParser(description="planted bugs and honest reruns of the gate")
    parser.add_argument("--bugs", type=int, default=len(BUGS), help="how many of the planted bugs")
    parser.add_argument("--skip", type=int, default=0, help="how many of them to pass over")
    parser.add_argument("--reruns", type=int, default=50, help="how many honest reruns")
    parser.add_argument("--jobs", type=int, default=1, help="honest reruns side by side")
    parser.add_argument("--baseline", type=Path, default=ROOT / "leaderboard/baselines/ci.json")
    parser.add_argument("--narrow", action="store_true", help="only what is to catch each bug")
    asked = parser.parse_args()
    chosen = BUGS[asked.skip :][: asked.bugs]
    with tempfile.TemporaryDirectory(prefix="sabench-gate-") as folder:
        pristine = copy_tree(ROOT, Path(folder) / "pristine")
        caught = [
            plant_bug(bug, pristine, Path(folder) / "planted", asked.baseline, asked.narrow)
            for bug in chosen
        ]
        with ThreadPoolExecutor(asked.jobs) as pool:
            rerun = functools.partial(honest, pristine, asked.baseline)
            silent = list(pool.map(rerun, range(asked.reruns)))
    print(
        f"{sum(caught)} of {len(caught)} planted bugs caught, "
        f"{sum(silent)} of {len(silent)} honest reruns silent"
    )
    sys.exit(not all(caught + silent))


def copy_tree(source: Path, target: Path) -> Path:
    """Copy the parts of a source tree that a check needs."""
    for name in _COPIED:
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name)
        else:
            shutil.copy2(source / name, target / name)
    return target


def plant_bug(bug: Bug, pristine: Path, tree: Path, baseline: Path, narrow: bool) -> bool:
    """Check a copy with the bug; returns whether the gate or its tests caught it."""
    text = (pristine / bug.file).read_text(encoding="utf-8")
    if text.count(bug.old) != 1:
        print(
            f"{bug.file}: {bug.title}: expected the text once, "
            f"got it {text.count(bug.old)} times: {bug.old!r}",
            flush=True,
        )
        return False
    copy_tree(pristine, tree)
    (tree / bug.file).write_text(text.replace(bug.old, bug.new), encoding="utf-8")
    caught = False
    if not (narrow and bug.tests):
        suite, figures = select_case(tree, baseline, bug.case) if narrow else ("ci", baseline)
        caught = is_alarmed(bug, tree, figures, suite)
    if not caught and bug.tests:
        caught = is_tested(bug, tree)
    shutil.rmtree(tree)
    return caught


def select_case(tree: Path, baseline: Path, case: str) -> tuple[str, Path]:
    """Write a suite of one case of `ci`, and its baseline; all cases if it is empty."""
    if not case:
        return "ci", baseline
    suite = tomllib.loads((tree / "scenes/suites/ci.toml").read_text(encoding="utf-8"))
    suite["cases"] = [one for one in suite["cases"] if one["name"] == case]
    figures = json.loads(baseline.read_text(encoding="utf-8"))
    figures["cases"] = [one for one in figures["cases"] if one["case"] == case]
    folder = tree / "narrow"
    folder.mkdir()
    (folder / "ci.toml").write_text(tomli_w.dumps(suite), encoding="utf-8")
    (folder / "ci.json").write_text(json.dumps(figures), encoding="utf-8")
    return "narrow/ci.toml", folder / "ci.json"


def is_alarmed(bug: Bug, tree: Path, baseline: Path, suite: str) -> bool:
    """Run the gate on a copy with a bug; print what it says first."""
    code, seconds, found = check(tree, baseline, suite)
    first = found["worse"][0] if found["worse"] else {}
    by = (
        f"{first['case']}, {first['solver']}: {first['text'] or first['figure']}"
        if first
        else "nothing"
    )
    was = (
        f" {first['before']:.5g} -> {first['now']:.5g}"
        if first and first["before"] is not None and first["now"] is not None
        else ""
    )
    print(
        f"{'caught' if code == 1 else 'MISSED'}  {seconds:4.0f} s  {bug.title} | {by}{was} | "
        f"{len(found['worse'])} figures",
        flush=True,
    )
    return code == 1


def is_tested(bug: Bug, tree: Path) -> bool:
    """Run the tests of a bug on a copy with it; print the first that fails."""
    start = time.perf_counter()
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-rf", "-p", "no:cacheprovider", bug.tests]
    environment = _environment(tree)
    done = subprocess.run(
        words, cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    failed = done.returncode == 1
    first = next((line for line in done.stdout.splitlines() if line.startswith("FAILED")), "")
    print(
        f"{'caught' if failed else 'MISSED'}  {time.perf_counter() - start:4.0f} s  {bug.title} | "
        f"{first.partition(' - ')[0] if failed else done.stdout[-500:]}",
        flush=True,
    )
    return failed


def _environment(tree: Path) -> dict[str, str]:
    """Return the variables of a run in a source tree, next to which its kernels are stored."""
    return os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree.parent / "kernels")}


def honest(tree: Path, baseline: Path, number: int) -> bool:
    """Check the copy as it is; returns whether it was silent."""
    code, seconds, found = check(tree, baseline)
    said = "; ".join(
        f"{one['case']}, {one['solver']}: {one['text'] or one['figure']} "
        f"{one['before']} -> {one['now']}"
        for one in found["worse"]
    )
    print(
        f"{'silent' if code == 0 else 'FAILED'}  {seconds:4.0f} s  rerun {number + 1} {said}",
        flush=True,
    )
    return code == 0


def check(tree: Path, baseline: Path, suite: str = "ci") -> tuple[int, float, dict[str, Any]]:
    """Run `sabench check` in a source tree: exit code, seconds, findings."""
    start = time.perf_counter()
    words = [
        sys.executable,
        "-m",
        "sabench",
        "check",
        suite,
        "--baseline",
        str(baseline.resolve()),
        "--json",
        "--exit-first",
    ]
    done = subprocess.run(
        words,
        cwd=tree,
        env=_environment(tree),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1) or not done.stdout:
        print(f"exit code {done.returncode}: {done.stderr[-500:]}", flush=True)
        return done.returncode, time.perf_counter() - start, {"worse": []}
    return done.returncode, time.perf_counter() - start, json.loads(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    main()
