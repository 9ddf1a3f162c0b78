"""Notebooks of the pages docs/notebooks/*.md: their runs, their files and their outputs.

A page's blocks of Python are the cells of the notebook NAME.ipynb next to it, which also holds
their outputs; the site shows these below the blocks. `python docs/site/notebooks.py` runs all
pages, each in an empty folder, and writes their notebooks.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sphinx.application import Sphinx

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}
Output = dict[str, Any]  # as notebooks hold it


def sources(text: str) -> list[tuple[str, str]]:
    """List the kind, "markdown" or "code", and the text of each cell of a page."""
    parts = enumerate(_BLOCK.split(text))
    return [(("markdown", "code")[n % 2], part.strip("\n")) for n, part in parts if part.strip()]


def codes(text: str) -> list[str]:
    """List the cells of code of a page."""
    return [source for kind, source in sources(text) if kind == "code"]


def run(cells: Sequence[str]) -> Iterator[list[Output]]:
    """Run cells of code in the current folder; yield the outputs of each."""
    names: dict[str, Any] = {"__name__": "notebook"}
    for number, cell in enumerate(cells, 1):
        yield list(_outputs(cell, names, number))


def _outputs(cell: str, names: dict[str, Any], number: int) -> Iterator[Output]:
    tree, value = ast.parse(cell), None
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(compile(tree, f"cell {number}", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), names)
    if out.getvalue():
        yield {"output_type": "stream", "name": "stdout", "text": _lines(out.getvalue())}
    if value is not None:
        data = {"text/plain": _lines(repr(value))}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = _lines(value._repr_html_())
        kind = {"output_type": "execute_result", "execution_count": number}
        yield kind | {"metadata": {}, "data": data}
    if "matplotlib.pyplot" in sys.modules:
        from matplotlib import pyplot

        for figure in pyplot.get_fignums():
            png = io.BytesIO()
            pyplot.figure(figure).savefig(png, metadata={"Software": None})
            shown = {"image/png": base64.b64encode(png.getvalue()).decode()}
            yield {"output_type": "display_data", "metadata": {}, "data": shown}
        pyplot.close("all")


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def notebook(name: str, text: str, outputs: Sequence[list[Output]]) -> str:
    """Write the notebook of a page with the outputs of its cells of code."""
    left, cells = iter(enumerate(outputs, 1)), []
    for number, (kind, source) in enumerate(sources(text)):
        cell = {"cell_type": kind, "id": f"{name}-{number}", "metadata": {}}
        if kind == "code":
            cell["execution_count"], cell["outputs"] = next(left)
        cells.append(cell | {"source": _lines(source)})
    metadata = {"kernelspec": _KERNEL, "language_info": {"name": "python"}}
    whole = {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def add_outputs(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the outputs of a page's notebook below its blocks, on the site."""
    stored = app.srcdir / f"{name}.ipynb"
    if not stored.exists():
        return
    cells = json.loads(stored.read_text(encoding="utf-8"))["cells"]
    shown = iter([cell["outputs"] for cell in cells if cell["cell_type"] == "code"])
    page = _BLOCK.sub(lambda block: "\n".join([block[0], *map(_shown, next(shown))]), source[0])
    source[0] = f"{page}\n[This page as a notebook]({stored.name})\n"


def _shown(output: Output) -> str:
    """Write an output as Markdown: text, a table with its picture, or a figure."""
    data = output.get("data", {})
    if "image/png" in data:
        html = f'<img alt="figure" src="data:image/png;base64,{data["image/png"]}">'
    else:
        html = "".join(data.get("text/html", ()))
    if html:
        return f"\n```{{raw}} html\n{html}\n```\n"
    return f"\n```output\n{''.join(data.get('text/plain') or output['text'])}\n```\n"


def main() -> None:
    """Run all pages and write their notebooks."""
    for page in sorted(FOLDER.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            outputs = list(run(codes(text)))
        page.with_suffix(".ipynb").write_text(notebook(page.stem, text, outputs), encoding="utf-8")
        print(f"{page.with_suffix('.ipynb')}: {len(outputs)} cells")


if __name__ == "__main__":
    os.environ["MPLBACKEND"] = "Agg"
    main()
