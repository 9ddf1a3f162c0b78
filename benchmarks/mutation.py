"""Mutation run: change random lines, and count what the unit tests notice.

    python benchmarks/mutation.py --seed 1 --count 40
    python benchmarks/mutation.py --count 40 --room geometry simulation metrics algorithms

Each mutant is one changed expression or one dropped statement in one module below `sabench/`. The
tests that mirror the module's package (`tests/unit/<package>`) run on it, in a copy of the tree.
A mutant is killed if they fail or do not end in time. Survivors are listed with their line. Some
are equivalent to the original or change a tuning constant only: compare figures of equal seeds.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_COPIED = ("sabench", "tests", "generators", "solvers", "scenes", "leaderboard", "pyproject.toml")
_SIGNS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
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
    def tests(self) -> Path:
        """The folder of tests that mirrors the module's package."""
        return Path("tests/unit") / self.module.parent.relative_to("sabench")

    def apply(self, text: str) -> str:
        """Return the text with the line replaced."""
        lines = text.splitlines(keepends=True)
        assert lines[self.line - 1] == self.before
        lines[self.line - 1] = self.after
        return "".join(lines)


def mutants_of(module: Path) -> list[Mutant]:
    """List all mutants of a module, a path relative to the root."""
    text = (ROOT / module).read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)
    found = []
    for kind, node, code in _changes(ast.parse(text)):
        before = lines[node.lineno - 1]
        raw = before.encode()
        after = (raw[: node.col_offset] + code.encode() + raw[node.end_col_offset :]).decode()
        mutant = Mutant(module, node.lineno, kind, before, after)
        if before != after and _parses(mutant.apply(text)):
            found.append(mutant)
    return found


def _parses(text: str) -> bool:
    try:
        compile(text, "mutant", "exec")
    except SyntaxError:
        return False
    return True


def _changes(tree: ast.Module) -> Iterator[tuple[str, ast.expr | ast.stmt, str]]:
    """Yield changes of nodes on a single line.

    Each is (kind, node, code to put in its place).
    """
    for node in _code(tree):
        if not isinstance(node, ast.expr | ast.stmt) or node.lineno != node.end_lineno:
            continue
        for kind, changed in _mutate(node):
            yield kind, node, ast.unparse(changed)


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """List a node and those below it, without messages, annotations, docstrings.

    Decorators are left out, too.
    """
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
    if isinstance(changed, ast.BinOp) and type(changed.op) in _SIGNS:
        changed.op = _SIGNS[type(changed.op)]()
        yield "sign", changed
    elif isinstance(changed, ast.UnaryOp) and isinstance(changed.op, ast.USub):
        yield "sign", changed.operand
    elif isinstance(changed, ast.Compare) and type(changed.ops[0]) in _COMPARISONS:
        changed.ops[0] = _COMPARISONS[type(changed.ops[0])]()
        yield "comparison", changed
    elif isinstance(changed, ast.Constant) and type(changed.value) is int:
        changed.value = {0: 1, 1: 0}.get(changed.value, changed.value + 1)
        yield "constant or axis", changed
    elif isinstance(changed, ast.AugAssign) or (
        isinstance(changed, ast.Expr) and isinstance(changed.value, ast.Call)
    ):
        yield "dropped line", ast.Pass()


def is_killed(mutant: Mutant, tree: Path, time_s: float) -> bool:
    """Return whether the mirrored tests fail on a mutant.

    The tree is restored afterwards.
    """
    file = tree / mutant.module
    text = file.read_text(encoding="utf-8")
    file.write_text(mutant.apply(text), encoding="utf-8")
    try:
        # a kernel that calls a changed one would come out of the cache unchanged
        cache = tree / ".numba" / ("mutant" if "numba" in text else "original")
        return not passes(mutant.tests, tree, cache, time_s)
    finally:
        file.write_text(text, encoding="utf-8")
        shutil.rmtree(tree / ".numba" / "mutant", ignore_errors=True)


def passes(tests: Path, tree: Path, cache: Path, time_s: float) -> bool:
    """Return whether the tests of a folder of the tree pass in time."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", str(tests)]
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_DIR": str(cache),
    }
    try:
        done = subprocess.run(
            words, cwd=tree, env=environment, capture_output=True, check=False, timeout=time_s
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def draw(seed: int, count: int, package: str) -> list[Mutant]:
    """Draw mutants without replacement from all modules whose package has tests."""
    modules = sorted((ROOT / "sabench" / package).rglob("*.py"))
    candidates = [
        mutant
        for module in modules
        for mutant in mutants_of(module.relative_to(ROOT))
        if any((ROOT / mutant.tests).glob("test_*.py"))
    ]
    return random.Random(seed).sample(candidates, min(count, len(candidates)))


def main() -> None:
    """Run the tests on sampled mutants and print the survivors."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice of mutants")
    parser.add_argument("--count", type=int, default=40, help="number of mutants")
    parser.add_argument(
        "--room",
        nargs="+",
        default=[""],
        help="packages below sabench/, which share the mutants evenly; all by default",
    )
    parser.add_argument("--time", type=float, default=600.0, help="seconds for each test run")
    options = parser.parse_args()
    share = options.count // len(options.room)
    drawn = [one for room in options.room for one in draw(options.seed, share, room)]
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in _COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(
                    source, tree / name, ignore=shutil.ignore_patterns("__pycache__", "pictures")
                )
            else:
                shutil.copy(source, tree / name)
        for tests in sorted({mutant.tests for mutant in drawn}):
            if not passes(tests, tree, tree / ".numba" / "original", 3.0 * options.time):
                sys.exit(f"{tests}: expected tests that pass on the original, got a failure")
        survivors = []
        for number, mutant in enumerate(drawn, 1):
            verdict = "killed" if is_killed(mutant, tree, options.time) else "survived"
            print(
                f"{number:3d} {verdict:8s} {mutant.module}:{mutant.line} {mutant.kind}", flush=True
            )
            if verdict == "survived":
                survivors.append(mutant)
    print(f"\n{len(drawn) - len(survivors)} of {len(drawn)} mutants killed, seed {options.seed}")
    for mutant in survivors:
        print(f"\n{mutant.module}:{mutant.line} survived ({mutant.kind})")
        print(f"- {mutant.before.strip()}\n+ {mutant.after.strip()}")


if __name__ == "__main__":
    main()
