"""The imports that a plug-in may have.

The rule for authors: only from `sabench.api` and `sabench.algorithms`.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.architecture.plan import ROOT

ALLOWED = {
    "solvers": {"sabench.api", "sabench.algorithms"},
    "generators": {"sabench.api", "sabench.algorithms", "sabench.worlds.library"},
}
ADAPTERS = {"openlpt", "optv"}  # of other programs: also sabench.interop
PLUG_INS = [file for kind in ALLOWED for file in sorted((ROOT / kind).glob("[a-z]*.py"))]


def imported(file: Path) -> set[str]:
    """Modules of sabench from which a file imports."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found.add(str(node.module))
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return {name for name in found if name.split(".")[0] == "sabench"}


@pytest.mark.parametrize("file", PLUG_INS, ids=lambda file: file.stem)
def test_a_plug_in_imports_from_the_public_packages_only(file: Path) -> None:
    allowed = ALLOWED[file.parent.name]
    if file.stem in ADAPTERS:
        allowed = allowed | {"sabench.interop"}
    for name in imported(file):
        assert any(name == one or name.startswith(f"{one}.") for one in allowed), name


@pytest.mark.parametrize("file", PLUG_INS, ids=lambda file: file.stem)
def test_a_plug_in_imports_from_packages_not_from_their_modules(file: Path) -> None:
    """Plug-ins import from `sabench.algorithms.refocus`, not from a module inside it.

    These modules may be split and renamed.
    """
    for name in imported(file):
        if name.startswith(("sabench.api", "sabench.algorithms")):
            assert (ROOT / Path(*name.split("."))).is_dir(), name


def test_packages_of_algorithms_name_their_public_functions() -> None:
    for folder in sorted((ROOT / "sabench" / "algorithms").glob("[a-z]*/")):
        source = (folder / "__init__.py").read_text(encoding="utf-8")
        assert "__all__" in source, folder.name
