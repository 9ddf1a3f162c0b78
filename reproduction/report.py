"""Rows written to a file, and a page of them with curves beside the values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined

from sabench.plotting.charts import Figure
from sabench.plotting.drawing import draw
from sabench.utils.files import canonical_json, complete_or_nothing
from sabench.utils.number_text import significant
from sabench.utils.progress import announce_compiling, console

from . import MEASUREMENTS, reproduce, resolve
from .catalogue import MEASURED, judged, read_rows

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Reproduction of the thesis</title>
<style>
body { font: 15px/1.45 sans-serif; color: #000; background: #fff; margin: 1.5em auto;
       max-width: 1280px; padding: 0 1em; }
h1 { font-size: 1.35em; } h2 { font-size: 1.1em; margin-top: 2em; }
.item { display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
.rows { flex: 1 1 560px; overflow-x: auto; }
.curves { flex: 1 1 420px; margin: 0; }
.curves img { max-width: 100%; height: auto; border: 1px solid #ddd; }
table { border-collapse: collapse; width: 100%; }
td, th { text-align: left; padding: 0.15em 0.6em; border-bottom: 1px solid #ddd;
         vertical-align: top; }
td.value { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.note { color: #444; font-size: 0.9em; }
.good { color: #00573a; font-weight: bold; }
.bad { color: #a11000; font-weight: bold; }
</style>
</head>
<body>
<h1>Reproduction of the thesis</h1>
<p>The thesis is J. Belden, Synthetic Aperture Imaging for Three Dimensional Resolution of Fluid
Flows, MIT. Values are means over seeds, with half widths of 95 % confidence intervals.
{% if small %}<strong>Images were smaller than the scenes': values are not comparable.</strong>
{% endif %}</p>
<h2>All tables and figures</h2>
<div class="rows"><table>
<tr><th>name</th><th>what it shows</th><th>verdict</th><th>measured by</th></tr>
{% for one in entries %}
<tr><td>{{ one.name }}</td><td>{{ one.shows }}</td>
<td class="{{ one.verdict | grade }}">{{ one.verdict }}</td>
<td>{% if one.item in items %}<a href="#{{ one.item }}">{{ one.item }}</a>
{% else %}{{ one.item }}{% endif %}</td></tr>
{% endfor %}
</table></div>
{% for name, rows in items.items() %}
<h2 id="{{ name }}">{{ name }}: {{ measurements[name].title }}</h2>
<div class="item">
<div class="rows"><table>
<tr><th>row</th><th>thesis</th><th>ours</th><th>seeds</th><th>verdict</th></tr>
{% for row in rows %}
<tr><td>{{ row.name }}</td><td class="value">{{ row.thesis | value }}</td>
<td class="value">{{ row.measured | value }}{{ row.ci95 | interval }}</td>
<td class="value">{{ row.seeds or "-" }}</td>
<td class="{{ row.verdict | grade }}">{{ row.verdict }}</td></tr>
{% if row.note %}<tr><td class="note" colspan="5">{{ row.note }}</td></tr>{% endif %}
{% endfor %}
</table></div>
{% for plot in plots.get(name, []) %}
<figure class="curves"><img src="{{ plot.name }}.png" alt="{{ plot.title }}"></figure>
{% endfor %}
</div>
{% endfor %}
</body>
</html>
"""


def measure(
    names: Sequence[str],
    seeds: int | None,
    pixels: int | None,
    output: Path | None,
    folder: Path | None,
) -> list[dict[str, Any]]:
    """Measure item by item, and write rows, plots and page.

    Rows of an item replace those of the file when all of them are measured.

    Parameters
    ----------
    output : JSON file of rows.
    folder : folder of plots and of a page of all values.
    """
    chosen = resolve(names)
    kept = read_rows(output) if output else []
    announce_compiling()
    rows: list[dict[str, Any]] = []
    plots: dict[str, list[Figure]] = {}
    for name in chosen:
        for item in reproduce([name], seeds, pixels):
            if isinstance(item, Figure):
                plots.setdefault(name, []).append(item)
                if folder:
                    _write(folder / f"{item.name}.png", draw(item))
                continue
            rows.append(asdict(item))
            values = f"{significant(item.measured)}, thesis {significant(item.thesis)}"
            console.print(f"{item.name}: {values}: {item.verdict}", markup=False, highlight=False)
        kept = [row for row in kept if row["item"] != name]
        if output:  # an interrupted run keeps what is complete
            _write(output, canonical_json([*kept, *rows]).encode())
        if folder:
            _write(folder / "index.html", _page(rows, plots).encode())
    return rows


def _write(file: Path, content: bytes) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    with complete_or_nothing(file, overwrite=True) as partial:
        partial.write_bytes(content)


def _page(rows: Sequence[Mapping[str, Any]], plots: Mapping[str, Sequence[Figure]]) -> str:
    """Render a page beside whose file the plots lie as NAME.png."""
    now = {row["item"] for row in rows}
    recorded = [row for row in read_rows(MEASURED) if row["item"] not in now]
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["value"] = significant
    environment.filters["grade"] = _grade
    environment.filters["interval"] = lambda half: "" if half is None else f" ± {half:.2g}"
    return environment.from_string(_PAGE).render(
        entries=judged([*recorded, *rows]),
        items={name: list(own) for name, own in groupby(rows, lambda row: row["item"])},
        measurements=MEASUREMENTS,
        plots=plots,
        small=any(row["pixels"] for row in rows),
    )


def _grade(verdict: str) -> str:
    """Choose the style of a verdict."""
    return {
        "reproduced": "good",
        "exceeds": "good",
        "below": "bad",
        "not reproduced": "bad",
        "not reached": "bad",
    }.get(verdict, "")
