"""Every notebook runs, in this process and an empty folder; the site shows outputs of some."""

import itertools
import json
import re
from pathlib import Path
from typing import Any

import matplotlib
import pytest

from tests.docs.pages import ROOT, read, site

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
    assert len(NOTEBOOKS) == 3
    pages = read("docs/start/student.md") + read("docs/start/training-data.md")
    assert not [path.name for path in NOTEBOOKS if f"notebooks/{path.name})" not in pages]


SHOWN = sorted((ROOT / "docs" / "notebooks").glob("*.md"))
COST = re.compile(r"^ *(?:time|seconds|peak_mb|hash)\b.*$|\b[0-9a-f]{12}\b", re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.\d*)?(?:e[+-]?\d+)?")


def texts(outputs: list[dict[str, Any]]) -> str:
    """The text of a cell's outputs, without costs and hashes."""
    parts = [output.get("text") or output["data"].get("text/plain", ()) for output in outputs]
    return COST.sub("", "".join(itertools.chain(*parts)))


@pytest.mark.parametrize("path", SHOWN, ids=lambda path: path.stem)
def test_a_page_is_the_source_of_its_notebook(path: Path) -> None:
    text, stored = path.read_text(encoding="utf-8"), path.with_suffix(".ipynb")
    outputs = [cell["outputs"] for cell in cells(stored, "code")]
    assert stored.read_text(encoding="utf-8") == site("notebooks")["notebook"](
        path.stem, text, outputs
    ), "run python docs/site/notebooks.py"
    assert stored.stat().st_size < 250_000
    for code in site("notebooks")["codes"](text):
        compile(code, str(path), "exec")
    assert any(outputs)


@pytest.mark.slow
@pytest.mark.parametrize("path", SHOWN, ids=lambda path: path.stem)
def test_pages_print_what_their_notebooks_hold(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SABENCH_PLUGINS", "")
    codes = site("notebooks")["codes"](path.read_text(encoding="utf-8"))
    stored = [texts(cell["outputs"]) for cell in cells(path.with_suffix(".ipynb"), "code")]
    for outputs, expected in zip(site("notebooks")["run"](codes), stored, strict=True):
        shown = texts(outputs)
        assert NUMBER.sub("#", shown).split() == NUMBER.sub("#", expected).split()
        numbers = [[float(one) for one in NUMBER.findall(text)] for text in (shown, expected)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=0.05)
