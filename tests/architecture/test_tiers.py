"""The daily tier of the tests: each file has a test in it, so that no kind of law leaves it."""

import ast

from tests.conftest import ROOT

# The particle search alone compiles for a minute; tests/unit/algorithms/particles tests its parts.
WHOLLY_SLOW = {"system/test_bayesian_ipr.py"}


def has_daily_test(text: str) -> bool:
    tests = [one for one in ast.parse(text).body if getattr(one, "name", "").startswith("test_")]
    marks = [[ast.unparse(mark) for mark in getattr(one, "decorator_list", [])] for one in tests]
    return any("pytest.mark.slow" not in own for own in marks)


def test_every_file_has_a_daily_test() -> None:
    folder = ROOT / "tests"
    slow = {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("test_*.py")
        if not has_daily_test(path.read_text(encoding="utf-8"))
    }
    assert slow == WHOLLY_SLOW
