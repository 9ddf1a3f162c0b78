"""The tables of solvers name every solver of the checkout, under its task."""

from __future__ import annotations

import re

from sabench import plugins
from tests.docs.pages import read


def _listed() -> dict[str, set[str]]:
    """Return the solvers of README's table by task."""
    table = read("README.md").partition("<!-- solvers -->")[2].partition("<!-- end solvers -->")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines() if "`" in line]
    return {task.split(":")[0].strip(): set(re.findall(r"`(\w+)`", names)) for task, names in rows}


def test_readme_lists_every_solver_under_its_task() -> None:
    found: dict[str, set[str]] = {}
    for name in plugins.names("solvers"):
        found.setdefault(plugins.load("solvers", name).task, set()).add(name)
    assert _listed() == found
