"""Facts about classes read from source."""

from pathlib import Path
from typing import Any

import pytest

from sabench.utils.class_source import constant, find_class, import_fault, parse_file
from sabench.utils.errors import InputError

SOURCE = '''
from sabench.api import {base} as Base

class Own(Base):
    """One line."""

class Named(Own):
    """Another line.

    More lines.
    """
    name = "named"
'''


def write(folder: Path, text: str) -> Path:
    file = folder / "named.py"
    file.write_text(text, encoding="utf-8")
    return file


def test_an_attribute_is_inherited_within_a_file_and_from_the_package(tmp_path: Path) -> None:
    source = parse_file(write(tmp_path, SOURCE.format(base="Flow")))
    found: Any = find_class(source, "named")
    assert found.summary == "Another line."
    assert constant(source, found, "makes") == "flow"
    assert constant(source, found, "colour") is None


def test_only_one_class_may_have_the_name(tmp_path: Path) -> None:
    twice = SOURCE.format(base="Flow") + '\nclass Again(Base):\n    name = "named"\n'
    assert find_class(parse_file(write(tmp_path, twice)), "named") is None
    assert find_class(parse_file(write(tmp_path, SOURCE.format(base="Flow"))), "other") is None


@pytest.mark.parametrize(
    ("statement", "fault"),
    [
        ("import numpy as np\nimport sabench.api\nimport xml.dom", ""),
        ("from sabench.algorithms import refocus\nfrom sabench.api import Solver", ""),
        ("from .other import x", ""),
        ("try:\n    import nowhere_at_all\nexcept ImportError:\n    pass", ""),
        ("from sabench.reproject import sweep", "line 1: there is no module sabench.reproject"),
        ("\nfrom sabench.api import Sollver", "line 2: sabench.api has no Sollver"),
        ("import nowhere_at_all.here", "line 1: no module named 'nowhere_at_all' is installed"),
    ],
)
def test_imports_that_must_fail_are_found(tmp_path: Path, statement: str, fault: str) -> None:
    assert import_fault(parse_file(write(tmp_path, statement))) == fault


@pytest.mark.parametrize("text", ["class Named(:\n", "x = '\0'"])
def test_what_is_no_python_is_bad_input(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"named\.py"):  # Python's own words follow
        parse_file(write(tmp_path, text))
