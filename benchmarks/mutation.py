"""Mutation run: change random operators and constants, and count what the tests notice.

    python benchmarks/mutation.py --seed 1 --count 40
    python benchmarks/mutation.py --count 40 --room geometry simulation/rendering metrics algorithms

Each mutant is one changed expression on one line of one module below `sabench/`. The tests that
enter the changed function run on it in a copy of the tree, the nearest and cheapest first, up to
the first failure. A mutant is killed if a test fails or uses up its CPU time. Survivors are listed
with their line. `--only TEXT ...` runs all mutants whose name contains a text, in place of a
sample. Some survivors are equivalent to the original or change a tuning constant only: compare
figures of equal seeds. The tests of every 100th mutant run on the original, too, and must pass.

The first run traces all chosen test files once, to store each test's CPU time and the functions of
`sabench/` that it enters: minutes. Compiled kernels are invisible to Python: a kernel's tests are
those that enter a function that names it, or whose file names it. The folder `work/mutation` keeps
this, the copies and the outcomes: what is known is not run again, survivors with `--again` only.
Delete the folder to start afresh; a change of the code does that, too.
"""

import argparse
import ast
import contextlib
import copy
import functools
import hashlib
import importlib
import itertools
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import Any

import numba
import pytest

ROOT = Path(__file__).resolve().parents[1]
_FORK = multiprocessing.get_context("fork")
_MEMORY_BYTES = 16 * 2**30
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


_OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.Div,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}


@dataclass(frozen=True)
class Mutant:
    """One changed line of one module."""

    module: Path
    line: int
    kind: str
    before: str
    after: str

    @property
    def name(self) -> str:
        """Name the change, in one line."""
        change = f"{self.kind}: {self.before.strip()} -> {self.after.strip()}"
        return f"{self.module}:{self.line} {change}"

    def apply(self, text: str) -> str:
        """Return the text with the line replaced."""
        lines = text.splitlines(keepends=True)
        assert lines[self.line - 1] == self.before
        lines[self.line - 1] = self.after
        return "".join(lines)


def mutants_of(module: Path) -> list[Mutant]:
    """List all mutants of a module, a path relative to the root."""
    text = (ROOT / module).read_text(encoding="utf-8")
    lines, found = text.splitlines(keepends=True), []
    for node in _code(ast.parse(text)):
        if not isinstance(node, ast.expr | ast.stmt) or node.lineno != node.end_lineno:
            continue
        before = lines[node.lineno - 1]
        raw = before.encode()
        for kind, changed in _mutate(node):
            code = ast.unparse(changed).encode()
            after = (raw[: node.col_offset] + code + raw[node.end_col_offset :]).decode()
            if before != after:
                found.append(Mutant(module, node.lineno, kind, before, after))
    return found


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """List a node and those below it, without messages, annotations, docstrings.

    Decorators are left out, too, and the `strict` of `zip`, which no input can show.
    """
    if isinstance(node, ast.keyword) and node.arg == "strict":
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_text(child):
                yield from _code(child)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Expr):
        return isinstance(node.value, ast.Constant)
    return isinstance(node, ast.JoinedStr | ast.Raise | ast.Import | ast.ImportFrom)


def _mutate(node: ast.expr | ast.stmt) -> Iterator[tuple[str, ast.AST]]:
    changed = copy.deepcopy(node)
    if isinstance(changed, ast.BinOp | ast.AugAssign) and type(changed.op) in _OPERATORS:
        changed.op = _OPERATORS[type(changed.op)]()
        yield "operator", changed
    elif isinstance(changed, ast.BoolOp):
        changed.op = ast.Or() if isinstance(changed.op, ast.And) else ast.And()
        yield "operator", changed
    elif isinstance(changed, ast.UnaryOp) and isinstance(changed.op, ast.USub | ast.Not):
        yield "operator", changed.operand
    elif isinstance(changed, ast.Compare) and type(changed.ops[0]) in _COMPARISONS:
        changed.ops[0] = _COMPARISONS[type(changed.ops[0])]()
        yield "operator", changed
    elif isinstance(changed, ast.Constant) and isinstance(changed.value, int | float):
        changed.value = _other(changed.value)
        yield "constant", changed
    if isinstance(changed, ast.AugAssign) or (
        isinstance(changed, ast.Expr) and isinstance(changed.value, ast.Call)
    ):
        yield "dropped line", ast.Pass()


def _other(value: float) -> float:
    if isinstance(value, bool):
        return not value
    return 0 if value == 1 else value + 1


def draw(options: argparse.Namespace) -> list[Mutant]:
    """Draw mutants of several rooms, which share them evenly and follow in turn."""
    drawn = []
    for room in options.room:
        modules = sorted((ROOT / "sabench" / room).rglob("*.py"))
        every = (one for module in modules for one in mutants_of(module.relative_to(ROOT)))
        own = [one for one in every if one.kind in options.kinds]
        if options.only:
            drawn.append([one for one in own if any(text in one.name for text in options.only)])
        else:
            count = min(options.count // len(options.room), len(own))
            drawn.append(random.Random(options.seed).sample(own, count))
    return [one for batch in itertools.zip_longest(*drawn) for one in batch if one is not None]


class Tracer:
    """A plug-in that notes each test's CPU time and the functions of sabench that it enters."""

    def __init__(self, tree: Path) -> None:
        self.root = f"{tree}/"
        self.notes: dict[str, Any] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Trace calls alone, not lines."""
        entered: set[tuple[str, int]] = set()

        def trace(frame: FrameType, event: str, value: object) -> None:
            place = frame.f_code.co_filename, frame.f_code.co_firstlineno
            if place not in entered and not self._imports(frame):
                entered.add(place)

        start = time.process_time()
        threading.settrace(trace)
        sys.settrace(trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)
            self.notes[item.nodeid] = {
                "cpu_s": round(time.process_time() - start, 2),
                "entered": sorted(
                    f"{name.removeprefix(self.root)}:{line}"
                    for name, line in entered
                    if name.startswith(f"{self.root}sabench/")
                ),
            }

    def _imports(self, frame: FrameType | None) -> bool:
        """Say whether a module calls this while it is imported, for whichever test comes first."""
        while frame:
            code, frame = frame.f_code, frame.f_back
            if code.co_name == "<module>" and code.co_filename.startswith(self.root):
                return True
        return False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Mark a test that fails on the original: it can notice nothing."""
        if report.failed:
            self.notes.setdefault(report.nodeid, {})["failed"] = True


class Chosen:
    """A plug-in that runs chosen tests in their order, and names the one that failed."""

    def __init__(self, tests: list[str], note: Path) -> None:
        self.order = {test: place for place, test in enumerate(tests)}
        self.note = note

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Drop and sort."""
        items[:] = [item for item in items if item.nodeid in self.order]
        items.sort(key=lambda item: self.order[item.nodeid])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write down the first failure."""
        if report.failed:
            self.note.write_text(report.nodeid, encoding="utf-8")


def run_pytest(tree: Path, words: list[str], plugin: object, cpu_s: float) -> int:
    """Run pytest in a forked process of its own group, in the tree; return the exit code."""
    process = _FORK.Process(target=_pytest, args=(tree, words, plugin, cpu_s))
    process.start()
    assert process.pid is not None
    try:
        process.join(10.0 * cpu_s)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    process.join()
    assert process.exitcode is not None
    return process.exitcode


def _pytest(tree: Path, words: list[str], plugin: object, cpu_s: float) -> None:
    os.setpgrp()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with (tree / "log.txt").open("w") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    os.chdir(tree)
    os.environ |= {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "kernels")}
    numba.config.reload_config()  # else it does so later, and forgets the folder of the sources
    sys.path.insert(0, str(tree))
    options = ["-x", "-q", "--tb=short"]
    for name in ("cacheprovider", "xdist", "hypothesispytest"):  # the last takes 1 s a session
        options += ["-p", f"no:{name}"]
    code = int(pytest.main([*options, *words], plugins=[plugin]))
    if isinstance(plugin, Tracer):
        (tree / "traced.json").write_text(json.dumps(plugin.notes), encoding="utf-8")
    sys.stdout.flush()
    os._exit(code)


class Reach:
    """Tests that enter each function, stored in a file from run to run."""

    def __init__(self, tree: Path, store: Path) -> None:
        self.tree = tree
        self.store = store
        self.files = json.loads(store.read_text(encoding="utf-8")) if store.exists() else {}

    def update(self, files: Iterable[Path], cpu_s: float) -> None:
        """Trace the test files that changed since they were traced."""
        for file in files:
            name = str(file.relative_to(self.tree))
            digest = hashlib.sha256(file.read_bytes()).hexdigest()
            if self.files.get(name, {}).get("sha256") == digest:
                continue
            notes = self.tree / "traced.json"
            notes.unlink(missing_ok=True)
            code = run_pytest(self.tree, ["--maxfail=1000", name], Tracer(self.tree), cpu_s)
            tests = json.loads(notes.read_text(encoding="utf-8")) if notes.exists() else {}
            self.files[name] = {"sha256": digest, "tests": tests}
            failed = [test for test, note in tests.items() if "failed" in note]
            spent = sum(note.get("cpu_s", 0.0) for note in tests.values())
            print(f"traced {name}: {len(tests)} tests, {spent:.0f} s, exit {code}", *failed)
            sys.stdout.flush()
            self.store.write_text(json.dumps(self.files), encoding="utf-8")

    def tests(self, module: Path, line: int, cpu_s: float) -> list[str]:
        """List tests that can notice a change of a line, the nearest and cheapest first.

        As many as take the CPU time at most.
        """
        wanted = self._of_line(module, line, self._entering)
        mirror = Path("tests/unit") / module.parent.relative_to("sabench")
        costs = {
            test: note.get("cpu_s", 0.0)
            for file in self.files.values()
            for test, note in file["tests"].items()
            if "failed" not in note
        }

        def key(test: str) -> tuple[bool, int, float]:
            file = Path(test.split("::")[0])
            near = 0 if file.name == f"test_{module.stem}.py" else 1 if file.parent == mirror else 2
            return costs[test] > 5.0, near, costs[test]

        chosen, spent = [], 0.0
        for test in sorted(wanted & costs.keys(), key=key):
            if spent + costs[test] <= cpu_s:
                chosen.append(test)
                spent += costs[test]
        return chosen

    @functools.cached_property
    def _entering(self) -> dict[str, set[str]]:
        entering: dict[str, set[str]] = defaultdict(set)
        for file in self.files.values():
            for test, note in file["tests"].items():
                for place in note.get("entered", ()):
                    entering[place].add(test)
        return entering

    def _of_line(self, module: Path, line: int, entering: dict[str, set[str]]) -> set[str]:
        """Find the tests that enter the function at a line, or else its callers, or its module."""
        text = (self.tree / module).read_text(encoding="utf-8")
        around = [one for one in functions(ast.parse(text)) if one.lineno <= line <= end(one)]
        for function in reversed(around):
            if found := entering.get(f"{module}:{first_line(function)}"):
                return found
        todo, done, found = [function.name for function in around[:1]], set(), set()
        names = self._names if around else {}
        while todo:
            name = todo.pop()
            done.add(name)
            for place, caller in names.get(name, ()):
                if place.startswith("tests/"):
                    found |= set(self.files.get(place, {"tests": {}})["tests"])
                elif tests := entering.get(place):
                    found |= tests
                elif caller not in done:
                    todo.append(caller)
        if not found:
            found = {
                t for p, tests in entering.items() if p.startswith(f"{module}:") for t in tests
            }
        return found

    @functools.cached_property
    def _names(self) -> dict[str, set[tuple[str, str]]]:
        """For each name, list the functions of sabench and the test files that use it."""
        names: dict[str, set[tuple[str, str]]] = defaultdict(set)
        for folder in ("sabench", "tests"):
            for file in (self.tree / folder).rglob("*.py"):
                path = str(file.relative_to(self.tree))
                tree = ast.parse(file.read_text(encoding="utf-8"))
                for function in functions(tree):
                    place = path if folder == "tests" else f"{path}:{first_line(function)}"
                    for node in ast.walk(function):
                        if isinstance(node, ast.Name):
                            names[node.id].add((place, function.name))
                        elif isinstance(node, ast.Attribute):
                            names[node.attr].add((place, function.name))
        return names


def functions(tree: ast.AST) -> list[ast.FunctionDef]:
    """List all functions, the outer before the inner."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def first_line(function: ast.FunctionDef) -> int:
    """Line where the function's code starts: its first decorator's."""
    return min([function.lineno, *(one.lineno for one in function.decorator_list)])


def end(function: ast.FunctionDef) -> int:
    """Last line of a function."""
    assert function.end_lineno is not None
    return function.end_lineno


def set_up(tree: Path) -> None:
    """Copy the files that git knows; a copy whose code differs is removed first."""
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
    for name in files:
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tree / name)
    stamp.write_text(code.hexdigest())


def is_killed(mutant: Mutant, tree: Path, tests: list[str], cpu_s: float) -> tuple[bool, str]:
    """Return whether the tests fail on a mutant, and which.

    The tree is restored afterwards, and so are the folders of kernels, of which other sources have
    other ones.
    """
    file, kernels = tree / mutant.module, tree / "kernels"
    text, times, before = file.read_text(encoding="utf-8"), file.stat(), set(kernels.glob("*"))
    compile(mutant.apply(text), str(file), "exec")  # else no test would have killed it
    file.write_text(mutant.apply(text), encoding="utf-8")
    try:
        return run(tree, tests, cpu_s)
    finally:
        file.write_text(text, encoding="utf-8")
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
        for made in set(kernels.glob("*")) - before:
            shutil.rmtree(made, ignore_errors=True)


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
    drawn = draw(options)
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
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice of mutants")
    parser.add_argument("--count", type=int, default=40, help="number of mutants")
    parser.add_argument("--only", nargs="+", metavar="TEXT", help="mutants whose names contain it")
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
    parser.add_argument("--tests", nargs="+", default=["tests/unit"], help="folders or files")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that run side by side")
    parser.add_argument("--work", type=Path, default=ROOT / "work" / "mutation")
    parser.add_argument("--again", action="store_true", help="run known survivors again")
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_WAIT_POLICY="PASSIVE")
    # a mutant may be as long and as old as the original
    sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
    main()
