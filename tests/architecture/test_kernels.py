"""Kernels that only kernels call are compiled without wrappers for Python."""

import ast
from collections.abc import Iterator
from pathlib import Path

from .plan import ROOT, syntax

Kernel = tuple[str, str]  # module and name
PLACES = ("sabench", "solvers", "generators", "reproduction", "benchmarks", "examples")


def decorator(node: ast.AST) -> str:
    if not isinstance(node, ast.FunctionDef) or not node.decorator_list:
        return ""
    return " ".join(ast.unparse(one) for one in node.decorator_list)


def is_kernel(node: ast.AST) -> bool:
    how = decorator(node)
    return "njit" in how or "inner_kernel" in how


def module(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts)


def used_outside(file: Path) -> Iterator[ast.AST]:
    """Names that Python uses, all but those in kernels, and imports."""
    waiting: list[ast.AST] = [syntax(file)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Name | ast.Attribute | ast.ImportFrom):
            yield node
        if not is_kernel(node):
            waiting.extend(ast.iter_child_nodes(node))


def test_kernels_are_inner_ones_where_python_calls_none() -> None:
    files = [one for place in PLACES for one in sorted((ROOT / place).rglob("*.py"))]
    files = [one for one in files if "_plugins" not in one.parts]
    kernels = {
        (module(file), node.name): decorator(node)
        for file in files
        if file.is_relative_to(ROOT / "sabench")
        for node in syntax(file).body
        if is_kernel(node) and isinstance(node, ast.FunctionDef)
    }
    called: set[Kernel] = set()
    for file in files:
        here = module(file)
        known = {name: (own, name) for own, name in kernels if own == here}
        found = list(used_outside(file))
        for node in found:
            if isinstance(node, ast.ImportFrom) and node.module:
                known |= {one.asname or one.name: (node.module, one.name) for one in node.names}
        for used in found:
            if isinstance(used, ast.Name):
                called.add(known.get(used.id, ("", "")))
            elif isinstance(used, ast.Attribute) and isinstance(used.value, ast.Name):
                called.add((".".join(known.get(used.value.id, ("", ""))), used.attr))
    cached = {
        kernel
        for kernel, how in kernels.items()
        if "always" not in how and ("cache" in how or "inner" in how)
    }
    inner = {kernel for kernel, how in kernels.items() if "inner" in how}
    assert len(inner) > 100
    assert sorted(inner) == sorted(cached - called)
