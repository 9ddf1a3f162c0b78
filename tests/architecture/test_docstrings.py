"""First lines of docstrings are short sentences with a head; files that texts name exist."""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.architecture.plan import ROOT, syntax

LENGTH = 80  # characters, exclusive
ENDS = (".", ":", "?")
HEADLESS = {"What", "Where", "How", "Whether", "Which", "Whose", "Who", "That", "Those"}


def docstrings(module: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line number and the first line of every docstring of a module."""
    for node in ast.walk(module):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node, clean=False)
            if text is not None:
                yield node.body[0].lineno, text.strip().partition("\n")[0]


def faults(first: str) -> list[str]:
    found = []
    if len(first) >= LENGTH:
        found.append(f"expected fewer than {LENGTH} characters, got {len(first)}")
    if not first.endswith(ENDS):
        found.append(f"expected one of {' '.join(ENDS)} at the end")
    if first.partition(" ")[0] in HEADLESS:
        found.append("expected a verb or a noun phrase at the beginning")
    return found


@pytest.mark.slow_but_first
@pytest.mark.parametrize("folder", ["sabench", "solvers", "generators", "reproduction"])
def test_first_lines_are_short_and_have_a_head(folder: str) -> None:
    offenders = [
        f"{file.relative_to(ROOT)}:{line}: {fault}: {first}"
        for file in sorted((ROOT / folder).rglob("*.py"))
        for line, first in sorted(docstrings(syntax(file)))
        for fault in faults(first)
    ]
    assert not offenders, f"{len(offenders)} docstrings\n" + "\n".join(offenders)


@pytest.mark.parametrize(
    ("first", "fault"),
    [
        ("", "at the end"),
        ("Return the grid", "at the end"),
        ("What a solver sees.", "at the beginning"),
        (f"{'x' * 79}.", "got 80"),
        ("Return the grid.", None),
        ("Whereabouts of a body.", None),
        (f"{'x' * 78}?", None),
    ],
)
def test_a_bad_first_line_is_found(first: str, fault: str | None) -> None:
    assert [str(fault) in one for one in faults(first)] == [True] * (fault is not None)


def test_docstrings_of_modules_classes_and_functions_are_read() -> None:
    source = '"""A."""\nclass B:\n    """B.\n\n    More."""\n    async def c(self):\n        "C."\n'
    assert sorted(docstrings(ast.parse(source))) == [(1, "A."), (3, "B."), (7, "C.")]


def test_files_that_sources_and_docs_name_exist() -> None:
    """Templates, and `tests/test_*.py`, are of the user's project."""
    files = [file for kind in ("py", "md") for file in ROOT.rglob(f"[!.]*.{kind}")]
    named = re.compile(r"(?<![\w./-])(?:sabench|tests/\w+|reproduction|benchmarks)/[\w/]+\.py\b")
    missing = {
        (file.relative_to(ROOT).as_posix(), name)
        for file in files
        if not {".venv", "build", "templates"} & set(file.relative_to(ROOT).parts)
        for name in named.findall(file.read_text(encoding="utf-8"))
        if not (ROOT / name).exists()
    }
    assert not missing
