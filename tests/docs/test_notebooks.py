"""Every notebook runs, in this process and an empty folder, and is stored without outputs."""

import json
from pathlib import Path
from typing import Any

import matplotlib
import pytest

from tests.docs.pages import ROOT, read

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


def cells(path: Path, kind: str) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in found if cell["cell_type"] == kind]


def run(path: Path) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": "notebook"}
    for cell in cells(path, "code"):
        exec(compile("".join(cell["source"]), f"{path.name}:{cell['id']}", "exec"), names)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    run(path)
    assert pyplot.get_fignums() or path.stem == "training_data"
    pyplot.close("all")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_stored_without_outputs(path: Path) -> None:
    for cell in cells(path, "code"):
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
    assert "".join(cells(path, "markdown")[0]["source"]).startswith("# ")


def test_a_page_links_to_every_notebook() -> None:
    assert len(NOTEBOOKS) == 4
    pages = read("docs/start/student.md") + read("docs/start/training-data.md")
    assert not [path.name for path in NOTEBOOKS if f"notebooks/{path.name})" not in pages]
