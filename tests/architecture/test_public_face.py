"""The names that `import sabench` offers, at run time and to type checkers."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

import sabench

ROOT = Path(__file__).resolve().parents[2]


def test_every_offered_name_exists() -> None:
    assert "Dataset" in dir(sabench)
    for name in dir(sabench):
        assert getattr(sabench, name) is not None


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="scor"):
        sabench.scor  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("name", dir(sabench))
def test_every_offered_name_has_a_docstring(name: str) -> None:
    if not name.startswith("__"):
        assert inspect.getdoc(getattr(sabench, name))


def test_the_package_declares_that_it_is_typed() -> None:
    assert (ROOT / "sabench/py.typed").is_file()
    assert (ROOT / "sabench/__init__.pyi").is_file()
