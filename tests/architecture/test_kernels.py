"""Kernels that only kernels call are compiled without wrappers for Python."""

import ast
from collections.abc import Iterator
from pathlib import Path

from .plan import ROOT, syntax

Kernel = tuple[str, str]  # module and name
PLACES = ("sabench", "solvers", "generators", "reproduction", "benchmarks", "examples")


def decorator(node: ast.AST) -> str:
    if not isinstance(node, ast.FunctionDef):
        return ""
    return " ".join(ast.unparse(one) for one in node.decorator_list)


def is_kernel(node: ast.AST) -> bool:
    return "njit" in decorator(node) or "inner_kernel" in decorator(node)


def module(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts)


def names_outside(node: ast.AST) -> Iterator[ast.expr]:
    """Names that Python uses: all but those in kernels."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Name | ast.Attribute):
            yield child
        if not is_kernel(child):
            yield from names_outside(child)


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
        known = {name: (own, name) for own, name in kernels if own == module(file)}
        for node in ast.walk(syntax(file)):
            if isinstance(node, ast.ImportFrom) and node.module:
                known |= {one.asname or one.name: (node.module, one.name) for one in node.names}
        for used in names_outside(syntax(file)):
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
