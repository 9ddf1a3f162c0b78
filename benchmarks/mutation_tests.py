"""Choice and run of the tests that can notice a change: a part of `benchmarks/mutation.py`.

`Reach` runs each test file once on the unchanged tree, and stores for each test its CPU time and
the functions of `sabench/` that it enters. Compiled kernels are invisible to Python: a kernel's
tests are those that enter a function that names it, or whose file names it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import json
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

_FORK = multiprocessing.get_context("fork")
_MEMORY_BYTES = 16 * 2**30


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
            entered.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

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
    os.environ["PYTHONPATH"] = str(tree)
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
