"""Random changes of operators and constants: a part of `benchmarks/mutation.py`."""

from __future__ import annotations

import ast
import copy
import itertools
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
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
    function: str = ""

    @property
    def name(self) -> str:
        """Name the change, in one line."""
        return f"{self.module}:{self.line} {self.change}"

    @property
    def place(self) -> str:
        """Name the change by its function: lines move."""
        return f"{self.module} {self.function or 'module'} {self.change}"

    @property
    def change(self) -> str:
        """State the kind, and the line before and after."""
        return f"{self.kind}: {self.before.strip()} -> {self.after.strip()}"

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
    found, tree = [], ast.parse(text)
    for kind, node, code in _changes(tree):
        before = lines[node.lineno - 1]
        raw = before.encode()
        after = (raw[: node.col_offset] + code.encode() + raw[node.end_col_offset :]).decode()
        mutant = Mutant(module, node.lineno, kind, before, after, _around(tree, node.lineno))
        if before != after:
            found.append(mutant)
    return found


def _around(tree: ast.Module, line: int) -> str:
    """Name the innermost function at a line; empty outside functions."""
    around = [
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0)
    ]
    return around[-1] if around else ""


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


def draw(seed: int, count: int, package: str, kinds: list[str]) -> list[Mutant]:
    """Draw mutants without replacement from all modules of a package."""
    candidates = _candidates(package, kinds)
    return random.Random(seed).sample(candidates, min(count, len(candidates)))


def _candidates(package: str, kinds: list[str]) -> list[Mutant]:
    modules = sorted((ROOT / "sabench" / package).rglob("*.py"))
    found = [one for module in modules for one in mutants_of(module.relative_to(ROOT))]
    return [mutant for mutant in found if mutant.kind in kinds]


def select(texts: list[str], packages: list[str], kinds: list[str]) -> list[Mutant]:
    """Select all mutants of packages whose name or place contains one of the texts.

    Raises
    ------
    ValueError
        A text that no mutant contains.
    """
    candidates = [mutant for package in packages for mutant in _candidates(package, kinds)]
    names = [f"{mutant.name}\n{mutant.place}" for mutant in candidates]
    for text in texts:
        if not any(text in name for name in names):
            raise ValueError(f"--only: expected a part of a mutant's name, got {text!r}")
    chosen = [any(text in name for text in texts) for name in names]
    return [mutant for mutant, wanted in zip(candidates, chosen, strict=True) if wanted]


def draw_in_turn(seed: int, count: int, packages: list[str], kinds: list[str]) -> list[Mutant]:
    """Draw mutants of several packages, which share them evenly and follow in turn."""
    drawn = [draw(seed, count // len(packages), package, kinds) for package in packages]
    return [one for batch in itertools.zip_longest(*drawn) for one in batch if one is not None]
