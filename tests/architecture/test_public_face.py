"""The names that `import sabench` offers, at run time and to type checkers."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pytest

import sabench

ROOT = Path(__file__).resolve().parents[2]


def test_every_offered_name_exists() -> None:
    assert dir(sabench) == sorted(sabench.__all__)
    for name in dir(sabench):
        assert getattr(sabench, name) is not None


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="scor"):
        sabench.scor  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("name", sorted(sabench.__all__))
def test_every_offered_name_has_a_docstring(name: str) -> None:
    if not name.startswith("__"):
        assert inspect.getdoc(getattr(sabench, name))


def test_type_checkers_get_the_same_names_from_the_same_modules() -> None:
    tree = ast.parse((ROOT / "sabench/__init__.py").read_text(encoding="utf-8"))
    branch = next(node for node in tree.body if isinstance(node, ast.If))
    shown = {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    spaces = {name: f"sabench:{name}" for name in sabench._NAMESPACES}
    homes = {}
    for name, home in sabench._HOMES.items():
        module, _, original = home.partition(":")
        homes[name] = f"sabench.{module}:{original or name}"
    assert shown == homes | spaces
    assert {*shown, "__version__"} == set(sabench.__all__)


def test_the_package_declares_that_it_is_typed() -> None:
    """`public_face_types.py` is the rest of this test: `make types` runs it."""
    assert (ROOT / "sabench/py.typed").is_file()
