"""State file for ParaView, which is not installed where tests run."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

from sabench.interop import vtkhdf
from sabench.interop.export import NAME, write_state


def _value(tree: ast.Module, name: str) -> ast.expr:
    """Find what a module assigns to a name, at whatever depth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            found = node.value
    return found


def test_a_state_is_python_and_knows_where_its_files_are(tmp_path: Path) -> None:
    """Quotes in the folder's name do no harm."""
    home = Path('/some where\'s "data"')
    write_state(tmp_path, home)
    tree = ast.parse((tmp_path / NAME).read_text(encoding="utf-8"))
    folder = _value(tree, "FOLDER")
    assert isinstance(folder, ast.Call)
    assert ast.literal_eval(folder.args[0]) == str(home)


def test_a_state_draws_every_kind_that_is_written(tmp_path: Path) -> None:
    """A kind without a drawing would stop the state."""
    write_state(tmp_path, tmp_path)
    tree = ast.parse((tmp_path / NAME).read_text(encoding="utf-8"))
    drawn = _value(tree, "DRAW")
    assert isinstance(drawn, ast.Dict)
    written = set(re.findall(r'"(\w+)_\{frame:04d\}\.vtkhdf"', inspect.getsource(vtkhdf)))
    assert len(written) >= 7
    assert {ast.literal_eval(key) for key in drawn.keys if key} == written | {"rig"}
