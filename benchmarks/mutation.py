"""Mutation run: change random operators and constants, and count what the tests notice.

    python benchmarks/mutation.py --seed 1 --count 40
    python benchmarks/mutation.py --count 40 --room geometry simulation/rendering metrics algorithms

Each mutant is one changed expression on one line of one module below `sabench/`. The tests that
enter the changed function run on it in a copy of the tree, the nearest and cheapest first, up to
the first failure. A mutant is killed if a test fails or uses up its CPU time. Survivors are listed
with their line. `--only TEXT ...` runs all mutants whose name contains a text, in place of a
sample, and `--only @FILE` those named by the lines of a file. Some survivors are equivalent to the
original or change a tuning constant only: compare figures of equal seeds. The tests of every 100th
mutant run on the original, too, and must pass.

The folder `work/mutation` keeps the copies, the functions that each test enters (the first run
traces all chosen test files: minutes) and the outcomes: what is known is not run again, survivors
with `--again` only. Delete the folder to start afresh; a change of the code does that, too.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from multiprocessing.process import BaseProcess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from benchmarks.mutants import Mutant, draw_in_turn, select  # noqa: E402
from benchmarks.mutation_tests import Chosen, Reach, run_pytest  # noqa: E402

# imported once, for all forks: what tests need of others (but not the renderer, which has threads)
_WARM = [
    "numpy",
    "scipy.optimize",
    "scipy.ndimage",
    "scipy.spatial",
    "numba",
    "cv2",
    "h5py",
    "pydantic",
    "skimage.measure",
    "matplotlib.figure",
    "typer",
    "rich",
    "tifffile",
    "psutil",
]


def set_up(tree: Path) -> None:
    """Copy the files that git knows.

    A copy whose code differs is removed first, with its caches.
    """
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    files = [name for name in names.split("\0") if name and (ROOT / name).is_file()]
    code = hashlib.sha256()
    for name in files:
        if name.startswith(("sabench/", "generators/", "solvers/")):
            code.update(name.encode() + (ROOT / name).read_bytes())
    stamp = tree / "code.txt"
    if not stamp.exists() or stamp.read_text() != code.hexdigest():
        shutil.rmtree(tree.parent, ignore_errors=True)
    if any(tree.rglob("*.kept")):  # a run was killed: its mutant may be in the caches
        shutil.rmtree(tree)
    for name in files:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name)
    stamp.write_text(code.hexdigest())


def is_killed(mutant: Mutant, tree: Path, tests: list[str], cpu_s: float) -> tuple[bool, str]:
    """Return whether the tests fail on a mutant, and which.

    The tree is restored afterwards.
    """
    file = tree / mutant.module
    text, times = file.read_text(encoding="utf-8"), file.stat()
    compile(mutant.apply(text), str(file), "exec")  # else no test would have killed it
    cached = [one for module in _blind(mutant, tree) for one in _caches(tree / module)]
    for one in cached:
        one.rename(f"{one}.kept")
    file.write_text(mutant.apply(text), encoding="utf-8")
    try:
        return run(tree, tests, cpu_s)
    finally:
        file.write_text(text, encoding="utf-8")
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
        for module in _blind(mutant, tree):
            for one in _caches(tree / module):
                one.unlink()
        for one in cached:
            Path(f"{one}.kept").rename(one)


def run(tree: Path, tests: list[str], cpu_s: float) -> tuple[bool, str]:
    """Return whether one of the tests fails, and which or why."""
    note = tree / "failed.txt"
    note.unlink(missing_ok=True)
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))
    code = run_pytest(tree, files, Chosen(tests, note), cpu_s)
    if code == 5:
        raise RuntimeError(f"{tree}/log.txt: expected tests that are there, got none of {tests}")
    reason = "on import" if code > 0 else f"signal {-code}"
    return code != 0, note.read_text(encoding="utf-8") if note.exists() else reason if code else ""


def _caches(module: Path) -> list[Path]:
    return [
        *module.parent.glob(f"__pycache__/{module.stem}.*.nb?"),
        *module.parent.glob(f"__pycache__/{module.stem}.*.pyc"),
    ]


def _blind(mutant: Mutant, tree: Path) -> list[Path]:
    """List the modules whose compiled kernels would come out of the cache unchanged."""
    found, todo = [mutant.module], [mutant.module]
    compiled = {
        file.relative_to(tree): file.read_text(encoding="utf-8")
        for file in (tree / "sabench").rglob("*.py")
    }
    compiled = {file: text for file, text in compiled.items() if "numba" in text}
    if mutant.module not in compiled and mutant.before[:1].isspace():
        return found  # kernels keep other modules' functions and global constants alone
    while todo:
        package, stem = todo[0].parent.as_posix().replace("/", "."), todo.pop(0).stem
        for file, text in compiled.items():
            if file not in found and (f"{package}.{stem} " in text or f"from {package} " in text):
                found.append(file)
                todo.append(file)
    return found


class Journal:
    """Outcomes of mutants, one line of JSON each: what was found earlier counts."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        self.known = {one["mutant"]: one for one in map(json.loads, lines)}

    def add(self, mutant: Mutant, killed: bool, by: str, tests: int, wall_s: float) -> None:
        """Append an outcome and print it."""
        line = {"mutant": mutant.name, "killed": killed, "by": by, "tests": tests}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line | {"wall_s": round(wall_s, 1)}) + "\n")
        print(f"{'killed' if killed else 'SURVIVED':8s} {wall_s:4.0f} s {mutant.name}", flush=True)

    def is_open(self, mutant: Mutant, again: bool) -> bool:
        """Return whether a mutant is to be run."""
        known = self.known.get(mutant.name)
        return known is None or (again and not known["killed"])


def work(
    tree: Path, mutants: list[Mutant], reach: Reach, journal: Journal, options: argparse.Namespace
) -> None:
    """Run the tests on some mutants, in a copy of the tree: one of the jobs."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped"))  # the copy is restored first
    for number, mutant in enumerate(mutants):
        tests, start = reach.tests(mutant.module, mutant.line, options.budget), time.monotonic()
        if number % 100 == 0 and tests and run(tree, tests, options.time)[0]:
            sys.exit(f"{mutant.module}: expected tests that pass on the original: {tree}/log.txt")
        killed, by = is_killed(mutant, tree, tests, options.time) if tests else (False, "no test")
        journal.add(mutant, killed, by, len(tests), time.monotonic() - start)


def work_side_by_side(mutants: list[Mutant], reach: Reach, options: argparse.Namespace) -> None:
    """Share the mutants among the jobs, each in a copy of its own with warm caches."""
    journal, jobs = Journal(options.work / "outcomes.jsonl"), list[BaseProcess]()
    todo = [mutant for mutant in mutants if journal.is_open(mutant, options.again)]

    def stop(*_: object) -> None:
        for job in jobs:
            job.terminate()

    signal.signal(signal.SIGTERM, stop)
    for number in range(options.jobs):
        tree = options.work / f"tree-{number}"
        shutil.rmtree(tree, ignore_errors=True)
        shutil.copytree(options.work / "tree", tree)
        share = todo[number :: options.jobs]
        started = multiprocessing.get_context("fork").Process(
            target=work, args=(tree, share, reach, journal, options)
        )
        started.start()
        jobs.append(started)
    for job in jobs:
        job.join()


def main() -> None:
    """Run the tests on sampled mutants and print the survivors."""
    options = parsed()
    drawn = (
        select(options.only, options.room, options.kinds)
        if options.only
        else draw_in_turn(options.seed, options.count, options.room, options.kinds)
    )
    for name in _WARM:
        importlib.import_module(name)
    tree = options.work / "tree"
    set_up(tree)
    reach = Reach(tree, options.work / "reach.json")
    places = [tree / place for place in options.tests]
    files = {file for place in places for file in [place, *place.rglob("test_*.py")]}
    reach.update(sorted(file for file in files if file.is_file()), options.time)
    work_side_by_side(drawn, reach, options)
    known = Journal(options.work / "outcomes.jsonl").known
    outcomes = [known[mutant.name] for mutant in drawn if mutant.name in known]
    print()
    for room in options.room:
        own = [one["killed"] for one in outcomes if one["mutant"].startswith(f"sabench/{room}")]
        chosen = "chosen by name" if options.only else f"seed {options.seed}"
        print(f"{room or 'all'}: {sum(own)} of {len(own)} mutants killed, {chosen}")
    print("\nsurvivors:", *(one["mutant"] for one in outcomes if not one["killed"]), sep="\n")


def parsed() -> argparse.Namespace:
    """Parse the command's words."""
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n", 1)[0], fromfile_prefix_chars="@"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice of mutants")
    parser.add_argument("--count", type=int, default=40, help="number of mutants")
    parser.add_argument(
        "--only", nargs="+", metavar="TEXT", help="mutants whose names contain it; @FILE: its lines"
    )
    parser.add_argument(
        "--room",
        nargs="+",
        default=[""],
        help="packages below sabench/, which share the mutants evenly; all by default",
    )
    parser.add_argument(
        "--kinds",
        nargs="+",
        default=["operator", "constant"],
        choices=["operator", "constant", "dropped line"],
    )
    parser.add_argument("--time", type=float, default=600.0, help="CPU seconds for each mutant")
    parser.add_argument(
        "--budget", type=float, default=60.0, help="CPU seconds of the tests that are chosen"
    )
    parser.add_argument(
        "--tests", nargs="+", default=["tests/unit", "tests/regression"], help="folders or files"
    )
    parser.add_argument("--jobs", type=int, default=1, help="mutants that run side by side")
    parser.add_argument("--work", type=Path, default=ROOT / "work" / "mutation")
    parser.add_argument("--again", action="store_true", help="run known survivors again")
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_WAIT_POLICY="PASSIVE")
    os.environ.pop("NUMBA_CACHE_DIR", None)  # caches lie beside the modules, in the copy
    main()
